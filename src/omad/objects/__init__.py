"""What an articulated object is: category specs, object models, poses, URDF."""
