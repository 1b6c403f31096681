"""What of a scene is the object, where no mask says so: planes are taken away, and what is left falls into things."""
