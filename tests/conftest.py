"""What all tests share."""

import gc
import inspect
import os
import signal
from functools import cache
from itertools import count
from pathlib import Path

import pytest

inspect.getsource = cache(inspect.getsource)  # which tyro asks for anew with every command line


def pytest_xdist_auto_num_workers():
    """One more than cores, as some wait for what they started; each grows to 2.5 GB."""
    return min((os.cpu_count() or 1) + 1, 4)


def pytest_configure(config):
    """Each of several processes begins to collect at folders of its own, and finds the others' files compiled."""
    told, tests = getattr(config, "workerinput", None), Path(__file__).parent
    if told and [Path(each).resolve() for each in config.args] == [tests]:
        folders = sorted({str(file.parent) for file in tests.glob("*/test_*.py")})
        first = int(told["workerid"].removeprefix("gw")) * len(folders) // told["workercount"]
        config.args = folders[first:] + folders[:first]


def pytest_collection_modifyitems(items):
    """Files with slow tests come first, so that quick ones are left for the process that is done before the other."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path not in slow, item.path))


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What is imported by the end of it stays, and is not to be looked through for garbage again and again."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def signals_that_count():
    """What runs in the background ignores Ctrl-C, and some libraries leave SIGTERM ignored: so would the processes that
    tests start."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@pytest.fixture(scope="session")
def caches(tmp_path_factory):
    """Folders that are not there yet."""
    root = tmp_path_factory.mktemp("caches")
    return (root / str(number) for number in count())


@pytest.fixture(autouse=True)
def cache_of_its_own(caches, monkeypatch):
    """No test reads or writes the user's cache."""
    monkeypatch.setenv("OMAD_CACHE", str(next(caches)))


@pytest.fixture
def begun_quickly(monkeypatch):
    """Helper processes are forked from one that has imported what they need; without this they begin from nothing."""
    from helpers.warm import warm
    from omad.common.processes import workers

    context = warm()
    monkeypatch.setattr(workers.multiprocessing, "get_context", lambda method: context)
