"""Ctrl-C and SIGTERM: one line and an exit code, at any moment. Imports nothing that takes long.

While a program starts and ends, a signal ends it at once; while it works, it is raised where the work is, so that what
is half done can be put in order.
"""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NoReturn

NAMES = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class Terminated(KeyboardInterrupt):
    """SIGTERM, which asks for the same as Ctrl-C."""


class _Received:
    """The first signal of this process; 0: none."""

    number = 0


def end_at_once() -> None:
    """From here on a signal ends the process with a line: there is nothing to put in order."""
    _on_signals(_end)


def raise_in_work() -> None:
    """From here on a signal is raised in the main thread as KeyboardInterrupt or ``Terminated``."""
    _on_signals(_raise)


def ignore_ctrl_c() -> None:
    """For a process that helps another one: that one was interrupted too, and says what is to be done."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@dataclass
class Stop:
    """Whether the work is to end at the next good place."""

    number: int = 0
    """Of the signal that asked for it."""

    def __bool__(self) -> bool:
        return bool(self.number)


@contextmanager
def deferred() -> Iterator[Stop]:
    """Ctrl-C and SIGTERM wait until the block has ended, which is to look at what is given and to end soon; a second
    one is not waited for. In another thread than the main one, which gets no signals, nothing is changed."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in NAMES}
    before = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def wait(number: int, frame: Any) -> None:
        stop.number = number
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in before:
        signal.signal(number, wait)
    try:
        yield stop
    finally:
        restore()
    if stop:
        signal.raise_signal(stop.number)
        raise KeyboardInterrupt  # where a program's own handler lets it go on


def exit_code() -> int:
    """What a shell expects of a process that a signal ended; 0 where there was none."""
    return 128 + _Received.number if _Received.number else 0


def _on_signals(handler: Any) -> None:
    for number in NAMES:
        if signal.getsignal(number) != signal.SIG_IGN:  # as nohup wants it
            signal.signal(number, handler)


def _end(number: int, frame: Any) -> NoReturn:
    os.write(2, f"omad: {NAMES[signal.Signals(number)]}\n".encode())
    os._exit(128 + number)


def _raise(number: int, frame: Any) -> NoReturn:
    _Received.number = _Received.number or number
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated
