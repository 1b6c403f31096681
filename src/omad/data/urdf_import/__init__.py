"""Other people's URDF models brought to canonical space."""
