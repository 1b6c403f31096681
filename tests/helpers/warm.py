"""Commands in processes of their own that are forked from one which has imported what is slow to import: they begin
after a tenth of a second, so that what a drill does to them it does to their work."""

import contextlib
import importlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Iterable
from functools import cache
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext

IMPORTED = [
    *["torch._dynamo", "torch.utils.tensorboard", "matplotlib.pyplot", "omad.cli.main", "omad.data.training_views"],
    *["omad.estimation.estimator", "omad.evaluation.confidence", "omad.training.train_net", "omad.data.source"],
    *["omad.data.urdf_import.importing", "omad.output.formats", "omad.applications.tracking.frames"],
]


@cache
def warm() -> ForkServerContext:
    """Begins processes; only where there is fork."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    return context


class Command:
    """``omad ARGUMENTS`` in the folder at hand, at the head of a process group. None of its files may be larger than
    ``largest`` bytes. ``constants``: modules, names in them, and what these are there."""

    def __init__(
        self, arguments: list[str], largest: int | None = None, constants: Iterable[tuple[str, str, int]] = ()
    ) -> None:
        self._said, said = warm().Pipe(duplex=False)
        self._process = warm().Process(
            target=_run, args=(arguments, os.getcwd(), dict(os.environ), said, largest, list(constants))
        )
        self._process.start()
        said.close()

    def alive(self) -> bool:
        return self._process.is_alive()

    def kill(self) -> None:
        """It and its helpers, at once."""
        for kill in (os.killpg, os.kill):  # it may not be the head of a group yet
            with contextlib.suppress(ProcessLookupError):
                kill(self._process.pid or 0, signal.SIGKILL)

    def end(self, seconds: float = 600.0) -> tuple[int, str]:
        """Its exit code, and what it said."""
        said = b""
        while wait([self._said], seconds) and (more := os.read(self._said.fileno(), 4096)):
            said += more
        self._process.join(seconds)
        assert self._process.exitcode is not None, f"still at work after {seconds} seconds"
        return self._process.exitcode, said.decode()


def _run(
    arguments: list[str],
    folder: str,
    environment: dict[str, str],
    said: Connection,
    largest: int | None,
    constants: list[tuple[str, str, int]],
) -> None:
    os.setsid()
    os.chdir(folder)
    os.environ.update(environment)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(said.fileno(), 2)
    said.close()
    sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w", buffering=1)
    if largest is not None:
        import resource  # not on Windows

        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
    for module, name, value in constants:
        setattr(importlib.import_module(module), name, value)
    sys.argv = ["omad", *arguments]
    from omad.__main__ import main

    main()
