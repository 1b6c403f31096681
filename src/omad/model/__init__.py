"""The learned model of a category: prior, networks, the fit, checkpoints and the shipped weights."""
