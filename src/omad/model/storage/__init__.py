"""How weights are kept: packed, and fetched from where they are."""
