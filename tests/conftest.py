"""What all tests share."""

import inspect
import os
import signal
from functools import cache

import pytest

inspect.getsource = cache(inspect.getsource)  # which tyro asks for anew with every command line


def pytest_xdist_auto_num_workers():
    """One more than cores, as some wait for what they started; each grows to 2.5 GB."""
    return min((os.cpu_count() or 1) + 1, 4)


def pytest_collection_modifyitems(items):
    """Files with slow tests come first, so that quick ones are left for the process that is done before the other."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(autouse=True)
def signals_that_count():
    """What runs in the background ignores Ctrl-C, and some libraries leave SIGTERM ignored: so would the processes that
    tests start."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@pytest.fixture(autouse=True)
def cache_of_its_own(tmp_path_factory, monkeypatch):
    """No test reads or writes the user's cache."""
    monkeypatch.setenv("OMAD_CACHE", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def begun_quickly(monkeypatch):
    """Helper processes are forked from one that has imported what they need; without this they begin from nothing."""
    from helpers.warm import warm
    from omad.common.processes import workers

    context = warm()
    monkeypatch.setattr(workers.multiprocessing, "get_context", lambda method: context)
