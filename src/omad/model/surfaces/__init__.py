"""Surfaces of objects that are known by their keypoints alone, carried over from objects that are known whole."""
