"""Many categories at once: which of them an object is of, with no more weights loaded than are asked."""
