"""What one does with estimates: follow an object, find it again, explore its category."""
