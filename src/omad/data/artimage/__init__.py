"""ArtImage, as its authors released it: images with truth, objects as surface points, and a writer of the same."""

from .images import ArtImage, open_artimage
from .layout import is_artimage
from .writer import write_artimage

__all__ = ["ArtImage", "is_artimage", "open_artimage", "write_artimage"]
