"""A training of three numbers, run as a script of its own by several processes:

python line_training.py FOLDER DEVICES[xNODES] STEPS [SAVE_SECONDS] [SECONDS_A_STEP]
"""

import gc
import sys
import time
from contextlib import suppress
from pathlib import Path

# ruff: noqa: E402
gc.set_threshold(50_000)  # or importing takes a quarter longer, in each of two dozen processes

import torch
from torch import Generator, Tensor, nn

from omad.common.errors import WorkError
from omad.common.processes.signals import raise_in_work
from omad.training.loop import Schedule, train
from omad.training.processes import Processes, start

BATCH = 12


class Line(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(2, 1)


def fresh(seed: int = 0) -> Line:
    torch.manual_seed(seed)
    return Line()


def schedule(steps: int, save_seconds: float = 60.0) -> Schedule:
    return Schedule(steps=steps, batch=BATCH, save_seconds=save_seconds, log_steps=1, learning_rate=0.05)


def drawn(count: int, generator: Generator) -> Tensor:
    return 2 * torch.rand(count, 2, generator=generator) - 1


def terms(model: Line, x: Tensor) -> dict[str, Tensor]:
    """The mean over samples (n, 2) of how far the line is off."""
    return {"fit": (model.layer(x) - x.sum(1, keepdim=True)).square().mean()}


def train_line(folder: Path, processes: Processes, steps: int, save_seconds: float = 60.0, pause: float = 0.0) -> Line:
    def loss_terms(model: Line, generator: Generator) -> dict[str, Tensor]:
        time.sleep(pause)
        return terms(model, drawn(processes.share(BATCH), generator))

    model = fresh(processes.rank)  # the first one's counts
    return train(model, loss_terms, schedule(steps, save_seconds), folder, {}, processes=processes)


def main() -> int:
    folder, processes, steps, *rest = sys.argv[1:]
    raise_in_work()
    devices, _, nodes = processes.partition("x")
    processes = start(int(devices), int(nodes or 1), 1, "cpu", "float32")
    with processes.heard():
        try:
            kept = train_line(Path(folder), processes, int(steps), *map(float, rest))
        except WorkError as error:
            if processes.first:
                print(error, file=sys.stderr)
            return 1
    if processes.first:
        torch.save(kept.state_dict(), Path(folder) / "kept.pt")
    return 0


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        sys.exit(main())
    sys.exit(143)
