"""Compiled functions: the decorators that make them, and where their compiled code is kept.

Machine code is kept on disk, so that a machine compiles once (tens of seconds) and then loads. It is kept where Numba
keeps it: in ``NUMBA_CACHE_DIR`` where that is set, else beside the source, else in the user's cache folder. Where none
of these can be written (a read-only image without a home) a private folder among the temporary files serves. Processes
that start together wait for the one that compiles and load what it kept.
"""

import os
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

import numba
from numba.core import config
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

from .stderr import tell


class _Compiled:
    """What this process had to compile, as it was not kept yet."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def add(self, name: str) -> None:
        """Tell a person why nothing else happens."""
        if not self.names:
            tell("omad: compiling for this machine, once; this takes up to a minute")
        self.names.append(name)


COMPILED = _Compiled()


class _KeptCode(FunctionCache):
    """Numba's cache of one function, safe for many processes at once. Numba alone lets each of them compile the same,
    and a process may read an entry that another one is replacing."""

    _lock: IO[bytes] | None = None
    """Held from the moment that a function has to be compiled until that ended."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        # a function's code holds that of those it calls, and Numba does not see when their files change
        self._cache_file._source_stamp = (self._cache_file._source_stamp, sys.modules["omad"].__version__)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """None where it is to be compiled: the lock is then held until ``release``."""
        with _locked(self._lock_path, shared=True):
            found = self._load(sig, target_context)
        if found is not None:
            return found
        if self._lock is None:
            self._lock = _locked(self._lock_path)
            found = self._load(sig, target_context)  # by now another process may have kept it
            if found is not None:
                self.release()
                return found
        target_context.refresh()
        COMPILED.add(self._py_func.__qualname__)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk is no reason to give no answer
            super().save_overload(sig, data)

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            # ``super().load_overload`` would first import all that compiling needs, which takes half a second; of that,
            # code that is loaded needs the runtime alone
            rtsys.initialize(target_context)
            return self._load_overload(sig, target_context)
        except Exception:  # a damaged file raises anything; what is compiled now takes its place
            with suppress(OSError):
                self.flush()
            return None

    def release(self) -> None:
        """Let other processes go on; whoever waits here would wait for ever if a compilation that failed or was
        interrupted kept the lock."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    @property
    def _lock_path(self) -> Path:
        return Path(self._cache_path) / f"{self._impl.filename_base}.lock"


def _locked(path: Path, shared: bool = False) -> IO[bytes]:
    """The file, locked against other processes until it is closed; a file without a lock where there are none."""
    try:
        import fcntl

        file = path.open("ab")
        fcntl.flock(file, fcntl.LOCK_SH if shared else fcntl.LOCK_EX)
        return file
    except (ImportError, OSError):  # Windows; a network's file system without locks
        return open(os.devnull, "ab")


def compiled(**options: Any) -> Callable[[Any], Any]:
    """A decorator that compiles with further ``options`` of Numba's, and keeps the code. It runs without the
    interpreter's lock."""

    def decorated(function: Any) -> Any:
        found: Any = numba.njit(error_model="numpy", nogil=True, **options)(function)
        kept = _kept_code(function)
        if kept is not None:
            found._cache = kept
            found.compile = _releasing(found.compile, kept)
        return found

    return decorated


def _releasing(compile_: Callable[[Any], Any], kept: _KeptCode) -> Callable[[Any], Any]:
    def ended(signature: Any) -> Any:
        try:
            return compile_(signature)
        finally:
            kept.release()

    return ended


def _kept_code(function: Any) -> _KeptCode | None:
    """None where no folder can be written."""
    try:
        return _KeptCode(function)
    except RuntimeError:  # Numba found none
        pass
    settings: Any = config
    others = settings.CACHE_DIR  # of the rest of the program, which keeps its code elsewhere
    try:
        settings.CACHE_DIR = str(_private_folder())
        return _KeptCode(function)
    except (OSError, RuntimeError):
        return None
    finally:
        settings.CACHE_DIR = others


@cache
def _private_folder() -> Path:
    """Of this user, among the temporary files. Code is loaded from it, so nobody else may write there."""
    user = getattr(os, "getuid", lambda: 0)()
    folder = Path(tempfile.gettempdir()) / f"omad-compiled-{user}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    ours = not hasattr(os, "getuid") or (found.st_uid == user and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH))
    return folder if stat.S_ISDIR(found.st_mode) and ours else Path(tempfile.mkdtemp(prefix="omad-compiled-"))


INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Of functions that only compiled code calls: no wrappers for Python and C to compile and to load."""
jit = compiled()
inner = compiled(**INNER)
