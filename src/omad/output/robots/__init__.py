"""Objects for simulators and robots: bodies that collide, masses, joints that hold; URDF, MJCF and USD."""
