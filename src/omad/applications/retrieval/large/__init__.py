"""Catalogues that need not fit into memory: a folder that grows by parts, and is asked where it lies."""
