"""Depth images of object models: rasteriser, viewpoints, camera noise, folders of views."""
