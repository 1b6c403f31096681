"""What all tests share."""

import signal

import pytest

# what runs in the background ignores Ctrl-C, and so would the processes that tests start
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def cache_of_its_own(tmp_path_factory, monkeypatch):
    """No test reads or writes the user's cache."""
    monkeypatch.setenv("OMAD_CACHE", str(tmp_path_factory.mktemp("cache")))
