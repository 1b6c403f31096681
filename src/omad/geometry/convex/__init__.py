"""Convex bodies, and solids as several of them."""
