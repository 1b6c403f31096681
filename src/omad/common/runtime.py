"""How the process uses the machine: device choice, the memory allocator, and time."""

import ctypes
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache

import torch

from .errors import InputError


def pick_device(name: str = "auto") -> torch.device:
    """'auto' is CUDA where there is one, else the CPU. Raises InputError for a device that is not there."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, dtype=torch.float64, device=device).item()  # as the fit needs; Apple's have no doubles
    except (RuntimeError, AssertionError, TypeError) as error:
        raise InputError(f"device {name!r} cannot be used here: choose cpu or auto") from error
    return device


def device_name(device: torch.device) -> str:
    """As its maker calls an accelerator; else CPU."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type.upper()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def keep_freed_memory() -> None:
    """Tell glibc to keep and reuse freed memory instead of returning it to the system tensor by tensor. Training on a
    CPU makes and frees large tensors all the time, and fresh pages cost more than the arithmetic: steps become 2.5 to 5
    times faster. Does nothing where there is no glibc."""
    M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_MAX = -1, -2, -4
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL("libc.so.6").mallopt
        mallopt(M_MMAP_MAX, 0)
        mallopt(M_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(M_TOP_PAD, 256 * 2**20)


@cache
def work_in_forks() -> None:
    """Let processes forked from this one compute, on one thread: the threads of PyTorch's own do not come along, and
    who waits for them waits for ever."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))


@contextmanager
def undisturbed() -> Iterator[None]:
    """PyTorch works as it does by default, whatever the caller's program has set: on the CPU where no device is named,
    without autocast and gradients, and outside of inference mode, whose tensors could not be written to later."""
    with ExitStack() as within:
        within.enter_context(torch.inference_mode(False))
        within.enter_context(torch.no_grad())
        for kind in filter(torch.is_autocast_enabled, ("cpu", "cuda")):
            within.enter_context(torch.autocast(kind, enabled=False))
        if torch.get_default_device().type != "cpu":
            within.enter_context(torch.device("cpu"))
        yield


@contextmanager
def undrawn() -> Iterator[None]:
    """What is drawn within leaves PyTorch's random numbers to the caller's program as they were: a network is made with
    random weights before it gets its own."""
    with torch.random.fork_rng(devices=[]):
        yield


class Stopwatch:
    """Seconds spent by name. It waits for the device, which may lag behind, before it looks at the clock."""

    def __init__(self, device: torch.device) -> None:
        self.seconds: dict[str, float] = {}
        self._device = device
        self._began = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the time since the last lap to ``name``."""
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._began
        self._began = now

    def shares(self, count: int) -> dict[str, float]:
        """The seconds of each of ``count`` things that were done together."""
        return {name: seconds / count for name, seconds in self.seconds.items()}
