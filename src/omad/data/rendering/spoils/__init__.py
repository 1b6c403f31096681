"""Views as cameras see them, with truth: surroundings, occluders, borders, wrong depth, wrong masks."""
