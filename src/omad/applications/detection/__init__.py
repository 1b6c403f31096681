"""All objects of a frame: they are found by geometry, and judged by how well the categories explain them."""
