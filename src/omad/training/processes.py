"""The processes of a training: one alone, or several on several machines, each of which makes its share of every batch.

Lightning Fabric starts them on one machine, or finds itself started by ``torchrun``, SLURM or another launcher that it
knows; they speak through torch.distributed (gloo between processors, nccl between accelerators). All of them hold the
same weights and take the same steps; the first alone reads and writes files. Fabric is an extra
(``pip install 'omad[cluster]'``); one process alone needs nothing of it.
"""

from __future__ import annotations

import atexit
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Literal, TypeVar

import numpy as np
import torch
from torch import Generator, Tensor, nn

from omad.common.errors import InputError, WorkError
from omad.common.files import one_line
from omad.common.runtime import pick_device
from omad.model.backbones.interface import Backbone, Features

Precision = Literal["float32", "bf16"]
PATIENCE = timedelta(minutes=10)
"""How long one process waits for another."""
LONG = timedelta(days=30)
"""How long it waits for what the first does alone."""
T = TypeVar("T")


@dataclass(frozen=True)
class Processes:
    """Those of one training, as each of them sees them."""

    device: torch.device
    """That this one computes on."""
    parts: int = 1
    """That a process makes its share of a batch in, one after the other, where memory holds no more at a time."""
    precision: Precision = "float32"
    """Of the backbone."""
    rank: int = 0
    count: int = 1
    fabric: Any = None

    @property
    def first(self) -> bool:
        """Whether this is the one that reads and writes."""
        return self.rank == 0

    def share(self, batch: int) -> int:
        """Samples of a ``batch`` that one part of this process's share has. Raises InputError where that is no whole
        number."""
        if batch % (self.count * self.parts):
            among = f"{self.count} processes" + (f" in {self.parts} parts each" if self.parts > 1 else "")
            raise InputError(f"--batch {batch}: cannot be dealt out evenly to {among}; give a multiple")
        return batch // (self.count * self.parts)

    def generator(self, seed: int, device: torch.device, step: int = 0) -> Generator:
        """Random numbers of this process's own, from the ``step`` on that it begins with."""
        own = np.random.SeedSequence((seed, self.rank, step)).generate_state(1, np.uint64)
        return Generator(device=device).manual_seed(seed if self.first else int(own[0]))

    def begin_alike(self, model: nn.Module) -> None:
        """Give all processes the first one's weights."""
        if self.fabric:
            model.load_state_dict(self.from_first(lambda: {name: t.cpu() for name, t in model.state_dict().items()}))

    def shorten(self, model: nn.Module) -> None:
        """From here on the backbone of ``model`` computes in the ``precision``."""
        for module in model.modules() if self.precision == "bf16" else ():
            if isinstance(module, Backbone):
                module.forward, module.pooled = _in_bf16(module.forward), _in_bf16(module.pooled)

    def average(self, gradients: Sequence[Tensor]) -> None:
        """Over all processes, in place."""
        if self.fabric:
            flat = torch.cat([gradient.flatten() for gradient in gradients])
            with _together():
                flat = self.fabric.all_reduce(flat, reduce_op="mean")
            for gradient, mean in zip(gradients, flat.split([g.numel() for g in gradients]), strict=True):
                gradient.copy_(mean.view_as(gradient))

    def mean(self, values: Tensor) -> Tensor:
        """Of what each process has."""
        if not self.fabric:
            return values
        with _together():
            return self.fabric.all_reduce(values.clone(), reduce_op="mean")

    def agree(self, *values: float) -> list[float]:
        """The largest of what each process says, number by number."""
        if not self.fabric:
            return list(values)
        with _together():
            said = torch.tensor(values, dtype=torch.float64)
            return self.fabric.all_reduce(said, reduce_op="max").tolist()

    def from_first(self, found: Callable[[], T]) -> T:
        """What ``found`` gives the first of them."""
        value = found() if self.first else None
        if self.fabric:
            with _together():
                value = self.fabric.broadcast(value)
        return value  # pyright: ignore[reportReturnType]

    def alone(self, work: Callable[[], T]) -> T:
        """What ``work`` gives the first of them, while the others wait for it, as long as it takes."""
        if not self.fabric:
            return work()
        with _together():
            waiting: Any = torch.distributed.new_group(backend="gloo", timeout=LONG)
        value = work() if self.first else None
        with _together():
            torch.distributed.barrier(waiting)
            torch.distributed.destroy_process_group(waiting)
        return self.from_first(lambda: value)  # pyright: ignore[reportReturnType]

    def all_of(self, own: Tensor) -> list[Tensor]:
        """The ``own`` tensor of each process, on the CPU and of one shape."""
        if not self.fabric:
            return [own]
        found = [torch.empty_like(own) for _ in range(self.count)]
        with _together():
            torch.distributed.all_gather(found, own)
        return found

    def take_leave(self) -> None:
        """Once all is said: nobody goes before the others have heard it, as what is under way would be lost."""
        if self.fabric:
            with suppress(RuntimeError):
                torch.distributed.barrier()

    @contextmanager
    def heard(self) -> Iterator[None]:
        """Of what ends all processes alike, the first one speaks for all."""
        try:
            yield
        except (InputError, WorkError, KeyboardInterrupt) as error:
            if self.first:
                raise
            raise SystemExit(2 if isinstance(error, InputError) else 1) from error


ALONE = Processes(torch.device("cpu"))


def start(devices: int, nodes: int, parts: int, device: str, precision: Precision) -> Processes:
    """The processes of a training: ``devices`` on each of ``nodes`` machines, of the kind that ``device`` names. Where
    they are several and nothing has started them, this process starts the others of its machine, which run the same
    command. Raises InputError where Fabric is not installed, or cannot start them."""
    kind = pick_device(device)
    if precision == "bf16" and kind.type == "cpu":
        raise InputError("--precision bf16: is for accelerators, and slower on this CPU; leave it out")
    if devices * nodes == 1:
        return Processes(kind, parts, precision)
    try:
        from lightning_fabric import Fabric
        from lightning_fabric.strategies.ddp import DDPStrategy
    except ImportError as error:
        said = f"--devices {devices} --nodes {nodes}: more processes than one need Lightning Fabric"
        raise InputError(f"{said}: pip install 'omad[cluster]'") from error
    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)
    # which ends the others where one hangs that nothing tells of the end of another, and says so
    logging.getLogger("lightning_fabric.strategies.launchers.subprocess_script").setLevel(logging.INFO)
    try:
        strategy = DDPStrategy(
            process_group_backend="cpu:gloo,cuda:nccl" if kind.type == "cuda" else "gloo", timeout=PATIENCE
        )
        fabric = Fabric(accelerator=kind.type, devices=devices, num_nodes=nodes, strategy=strategy)
        fabric.launch()
    except (RuntimeError, ValueError) as error:
        said = f"--devices {devices} --nodes {nodes}: the processes cannot be started"
        raise InputError(f"{said} ({one_line(error)}); say so many as there are") from error
    if kind.type == "cpu":  # threads that gloo leaves behind may abort a process that is done
        atexit.register(_leave)
    if fabric.global_rank > 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the answer is the first one's to give
    return Processes(fabric.device, parts, precision, fabric.global_rank, fabric.world_size, fabric)


def _leave() -> None:
    """Once, however many trainings were begun."""
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


@contextmanager
def _together() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:
        said = "another process of this training ended, or cannot be reached"
        raise WorkError(
            f"{said}; what was last saved is kept: give the command again, and it goes on from there"
        ) from error


def _in_bf16(own: Callable[..., Any]) -> Callable[..., Any]:
    """A backbone's ``own`` forward or pooled with its matrix products in half the bits; what it says has all of
    them."""

    def shortened(points: Tensor) -> Features | Tensor:
        with torch.autocast(points.device.type, torch.bfloat16):
            said = own(points)
        if isinstance(said, Tensor):
            return said.float()
        return Features(said.centres, said.dense.float(), said.pooled.float())

    return shortened
