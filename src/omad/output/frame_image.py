"""What a frame looks like under what is drawn over it: its colours where there are any, else its depth."""

import base64
import io

import matplotlib
import numpy as np
from PIL import Image

from omad.sensing.observation import Observation

QUALITY = 85
"""Of JPEG."""


def frame_image(observation: Observation) -> np.ndarray:
    """(H, W, 3) uint8 of an observation with a depth image: what the colour camera saw, or depth, near is bright and
    what was not measured is white."""
    if observation.color is not None:
        return observation.color
    assert observation.depth is not None
    depth, (near, far) = observation.depth, observation.depth_range
    share = np.clip((far - depth) / max(far - near, 1e-6), 0, 1)
    colours = np.rint(255 * matplotlib.colormaps["viridis"](np.linspace(0, 1, 255))[:, :3]).astype(np.uint8)
    return np.vstack([colours, [[255, 255, 255]]]).astype(np.uint8)[
        np.where(depth > 0, np.rint(254 * share), 255).astype(int)
    ]


def jpeg_uri(image: Image.Image) -> str:
    """As a page holds it."""
    stored = io.BytesIO()
    image.save(stored, "JPEG", quality=QUALITY)
    return "data:image/jpeg;base64," + base64.b64encode(stored.getvalue()).decode()
