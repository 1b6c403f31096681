"""The training commands: one network each, or all that a category needs."""
