"""Puts the baselines' weights of the checkout into the wheel."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

WEIGHTS = Path("omad/model/weights")


class CollectBaselines(BuildHookInterface):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        source = Path(self.root).parents[1] / "src" / WEIGHTS
        for folder in (*source.glob("*/ancsh"), *source.glob("*/siamese")):
            build_data["force_include"][str(folder)] = str(WEIGHTS / folder.relative_to(source))
