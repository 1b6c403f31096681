"""Puts those weights of the checkout into a wheel that its ``patterns`` name, but for its ``without``."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

WEIGHTS = Path("omad/model/weights")


class CollectWeights(BuildHookInterface):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        source = Path(self.root).parents[1] / "src" / WEIGHTS
        named = {folder for pattern in self.config["patterns"] for folder in source.glob(pattern) if folder.is_dir()}
        for folder in sorted(named - {source / name for name in self.config.get("without", [])}):
            build_data["force_include"][str(folder)] = str(WEIGHTS / folder.relative_to(source))
