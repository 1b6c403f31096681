"""The explorer: a local page with sliders for an object's shape and joints, and a depth file to fit."""
