"""What the world does to a training view: surroundings inside the mask, things in front, wrong and missing depth."""
