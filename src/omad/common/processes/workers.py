"""Processes that help one. They end with it, however it ends, and leave its interruption to it."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from typing import Any

from .signals import ignore_ctrl_c


def helpers(count: int, begin: Callable[..., None], *told: Any) -> ProcessPoolExecutor:
    """``count`` fresh processes (Windows has no more than 61), each of which begins with ``begin(*told)``."""
    spawn = multiprocessing.get_context("spawn")  # fork would copy the locks of running threads
    count = min(count, 61) if os.name == "nt" else count
    pool = ProcessPoolExecutor(count, spawn, _begin, (begin, *told))
    # they start with the first thing to do, and inherit what is ignored: Ctrl-C before they are ready would make each
    # of them print how far it had come
    before = None
    with suppress(ValueError):  # in another thread than the main one
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        for _ in range(count):  # one starts whenever all that are there are busy
            pool.submit(_nothing)
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)
    return pool


def _begin(begin: Callable[..., None], *told: Any) -> None:
    ignore_ctrl_c()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin(*told)


def _end_with_parent() -> None:
    """A parent that was killed cannot tell its helpers, and they would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _nothing() -> None:
    pass
