"""What depth cameras of several families do to exact depth: errors that neighbouring pixels share, ragged outlines,
pixels between fore- and background, holes.

``depth_noise`` is a stereo camera whose errors are white but for 3x3 pixels. On surfaces taken as flat real cameras err
more, and smoothly: their matching windows and filters spread one error over many pixels. Amplitudes and correlations
below are those measured on real frames, where a docstring says so; the forms are from the literature it names.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from .depth_noise import EDGE
from .smooth_fields import blobs, smooth_field

BLOB = 5.0
"""Pixels: smoothness of the holes."""
WANDER = 2.5
"""Pixels: smoothness of outlines that wander."""


@dataclass(frozen=True)
class Sensor:
    """A family of depth cameras, by one of its kind."""

    error: float
    """Standard deviation in metres of the error at ``distance``, without quantisation."""
    distance: float
    """Metres."""
    growth: float
    """The error grows with this power of the distance."""
    waves: float
    """Share of the error's variance that is smooth."""
    length: float
    """Pixels: smooth errors d pixels apart are correlated by exp(-d^2 / (4 length^2))."""
    grain: float
    """The same of the rest."""
    step: float = 0.0
    """Quantisation: distance of neighbouring depths at 1 m, in metres; it grows with the square of the distance."""
    ragged: float = 0.0
    """Standard deviation in pixels by which outlines wander to and fro."""
    flying: float = 0.0
    """Share of the pixels at depth edges that lie between fore- and background."""
    edge_drop: float = 0.0
    """Share of the pixels at depth edges without measurement."""
    grazing: float = float(np.radians(80))
    """Surfaces seen at more than this angle (radians) from their normal have no measurement."""
    holes: float = 0.0
    """Share of the measured pixels lost in blobs."""
    working: tuple[float, float] = (0.2, 10.0)
    """Metres between which its makers recommend it; farther or nearer it is not cut off here."""


ACTIVE_STEREO = Sensor(
    0.0033, 0.63, 2.0, waves=0.91, length=15.0, grain=0.8, ragged=1.2, flying=0.3, edge_drop=0.3, holes=0.01,
    working=(0.3, 3.0),
)  # fmt: skip
"""RealSense D435 and its like. Depth from disparity, whose error grows with the square of the distance (Keselman et
al., Intel RealSense Stereoscopic Depth Cameras, CVPR workshops 2017); block matching widens and ragges outlines.
Measured at 0.63 m: 2.9 mm, autocorrelation 0.79 at 8 pixels."""
CODED_LIGHT = Sensor(
    0.0104, 0.72, 1.0, waves=0.94, length=16.0, grain=0.8, ragged=0.8, flying=0.2, edge_drop=0.4, holes=0.015,
    grazing=float(np.radians(75)), working=(0.2, 1.5),
)  # fmt: skip
"""RealSense SR300. Stripes of coded light and a strong filter after them (Zabatani et al., Intel RealSense SR300 Coded
Light Depth Camera, PAMI 2020). Measured: 8.5 mm at 0.64 m and 9.6 mm at 0.80 m, autocorrelation 0.75 to 0.90 at 8
pixels, which is slower growth than the square that triangulation has."""
SPECKLE = Sensor(
    0.0035, 1.2, 2.0, waves=0.27, length=14.0, grain=0.6, step=0.0029, ragged=1.0, edge_drop=0.5, holes=0.01,
    working=(0.4, 4.0),
)  # fmt: skip
"""Kinect v1, Xtion, Structure. A fixed pattern of speckles, disparity in eighths of a pixel: errors and steps grow with
the square of the distance (Khoshelham and Elberink, Accuracy and Resolution of Kinect Depth Data, Sensors 2012; Nguyen
et al., Modeling Kinect Sensor Noise, 3DIMPVT 2012). Measured with a Structure at 1.2 m: 3.6 mm, autocorrelation 0.19
at 8 pixels."""
TIME_OF_FLIGHT = Sensor(
    0.0015, 1.0, 2.0, waves=0.4, length=20.0, grain=0.7, flying=0.7, edge_drop=0.1, holes=0.005,
    grazing=float(np.radians(84)), working=(0.4, 5.0),
)  # fmt: skip
"""Kinect v2, Azure Kinect. The phase's error goes with the inverse of the light that returns, so with the square of the
distance; light from several surfaces mixes, smoothly within them and at edges into flying pixels (Foix et al., Lock-in
Time-of-Flight Cameras: A Survey, IEEE Sensors Journal 2011; Sarbolandi et al., Kinect Range Sensing, CVIU 2015). No
frame of one was measured: amplitude and correlation are taken as a good camera's, for want of better."""
SENSORS = {
    "active_stereo": ACTIVE_STEREO,
    "coded_light": CODED_LIGHT,
    "speckle": SPECKLE,
    "time_of_flight": TIME_OF_FLIGHT,
}


@dataclass(frozen=True)
class Sensed:
    """What a sensor makes of an exact image."""

    depth: np.ndarray
    """(H, W) float32 metres, 0 where nothing is measured."""
    source: np.ndarray
    """(H, W) int64 flat index of the exact pixel whose surface each pixel shows: labels come from there."""


def sense(exact: np.ndarray, sensor: Sensor, cos_view: np.ndarray, rng: np.random.Generator) -> Sensed:
    """Depth (H, W) in metres (0 = nothing there) as the sensor sees it; the same for the same ``rng`` state.
    ``cos_view`` (H, W): |cos| between surface normal and ray."""
    source = _wander(exact, sensor.ragged, rng)
    depth, cosine = exact.ravel()[source], cos_view.ravel()[source]
    high, low = ndimage.maximum_filter(depth, 3), ndimage.minimum_filter(depth, 3)
    edge = (depth > 0) & (high - low > 2 * EDGE * depth)
    valid = (depth > 0) & (cosine > np.cos(sensor.grazing))
    fate = rng.random(depth.shape, dtype=np.float32)
    valid &= ~(edge & (fate < sensor.edge_drop))
    valid &= ~blobs(valid, sensor.holes, BLOB, rng)
    flies = edge & (low > 0) & (fate > 1 - sensor.flying)
    between = rng.random(depth.shape, dtype=np.float32)
    depth = np.where(flies, low + between * (high - low), depth)

    smooth, fine = (smooth_field(depth.shape, length, rng) for length in (sensor.length, sensor.grain))
    field = np.sqrt(sensor.waves) * smooth + np.sqrt(1 - sensor.waves) * fine
    depth = depth + sensor.error * (depth / sensor.distance) ** sensor.growth * field
    valid &= depth > 0
    if sensor.step > 0:  # equal steps of 1 / z
        inverse = np.rint(1 / (np.where(valid, depth, 1.0) * sensor.step))
        valid &= inverse > 0
        depth = 1 / (np.where(valid, inverse, 1.0) * sensor.step)
    return Sensed(np.where(valid, depth, 0.0).astype(np.float32), source)


def _wander(depth: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """(H, W) flat index of the pixel that each pixel shows in its place; its own where that one shows nothing."""
    height, width = depth.shape
    drift = [np.rint(sigma * smooth_field(depth.shape, WANDER, rng)).astype(np.int64) for _ in range(2)]
    rows = (np.arange(height)[:, None] + drift[0]).clip(0, height - 1)
    columns = (np.arange(width) + drift[1]).clip(0, width - 1)
    source = rows * width + columns
    return np.where(depth.ravel()[source] > 0, source, np.arange(depth.size).reshape(depth.shape))
