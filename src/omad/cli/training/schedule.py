"""The schedule's options, which all trainings share."""

from __future__ import annotations

from dataclasses import dataclass, replace

from omad.common.lazy import lazy_imports

from ..options import Seed, check_positive, use_threads

with lazy_imports():
    from omad.training.loop import Schedule


@dataclass(frozen=True, kw_only=True)
class ScheduleOptions:
    """How long a training goes on, and in which steps."""

    steps: int | None = None
    """Optimiser steps; default: 3000 of a prior, 20000 of a network (hours of a core), 5000 of proposals, and of fronts
    8000 for what tells categories and 2600 for what tells hands."""
    batch: int | None = None
    """Samples a step, of all processes together; default: the preset's."""
    learning_rate: float | None = None
    """Peak learning rate; default: the preset's. Half of it serves for fine-tuning."""
    max_minutes: float | None = None
    """Finish within this time, learning-rate decay and all."""
    save_seconds: float = 60.0
    """How often the state to resume from is written; on Ctrl-C and SIGTERM it is, too."""
    seed: Seed = 0
    threads: int = 0
    """CPU threads; 0: PyTorch's choice. One is faster than two where another program computes."""

    def of(self, preset: Schedule) -> Schedule:
        """The ``preset``, but for what is asked for; PyTorch takes its threads from here on. Raises InputError."""
        asked = {"steps": self.steps, "batch": self.batch, "learning_rate": self.learning_rate}
        check_positive(max_minutes=self.max_minutes, save_seconds=self.save_seconds, **asked)
        use_threads(self.threads)
        given = {name: value for name, value in asked.items() if value is not None}
        return replace(preset, seed=self.seed, max_minutes=self.max_minutes, save_seconds=self.save_seconds, **given)
