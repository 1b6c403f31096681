"""Cameras, images and clouds of other packages, taken by what they carry: none of these packages is imported here, and
nothing else tells their objects from others."""
