"""Backbones by name, as the command line takes them. A new one is a file beside ``pointnet2`` and an entry here."""

from dataclasses import asdict
from typing import Any

from omad.common.decode import decode, within
from omad.common.errors import InputError

from .interface import BackboneConfig
from .pointnet2 import PointNet2Config

BACKBONES: dict[str, BackboneConfig] = {
    "slim": PointNet2Config(),
    "fine": PointNet2Config(points=1024, centres=(256, 64)),
    "paper": PointNet2Config(
        points=1024, centres=(512, 128), neighbours=(64, 64), widths=(128, 256, 512), dense=128, radii=(0.2, 0.4)
    ),
}
"""``slim`` is fast on a CPU; ``fine`` has its weights, but looks at twice as many points, for objects of many parts;
``paper`` is the paper's PointNet++."""
SLIM = BACKBONES["slim"]


def get_backbone(name: str | None, start: BackboneConfig | None = None) -> BackboneConfig:
    """That of a name; where none is given, that of what a training starts from, or the slim one. Raises InputError for
    a name that is not in ``BACKBONES``."""
    if name is None:
        return start or SLIM
    if name not in BACKBONES:
        raise InputError(f"--size {name}: no such backbone; choose one of {', '.join(BACKBONES)}")
    return BACKBONES[name]


def backbone_to_dict(config: BackboneConfig) -> dict[str, Any]:
    """For a checkpoint's JSON."""
    return {"kind": config.kind, **asdict(config)}


def backbone_from_dict(values: dict[str, Any]) -> BackboneConfig:
    """What ``backbone_to_dict`` wrote; early checkpoints, all of them PointNet++, tell no kind. Raises ValueError."""
    kinds = {config.kind: type(config) for config in BACKBONES.values()}
    kind = values.get("kind", PointNet2Config.kind)
    if kind not in kinds:
        raise ValueError(f"backbone.kind: is unknown; use {', '.join(kinds)}")
    with within("backbone."):
        return decode(kinds[kind], {name: value for name, value in values.items() if name != "kind"})
