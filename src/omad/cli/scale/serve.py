"""``omad serve``: estimates over HTTP."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

from omad.common.errors import InputError
from omad.common.lazy import lazy_imports
from omad.common.stderr import tell

from ..answer import Answer
from ..explore import LOCAL, free_port
from ..options import CategoriesCommand, check_positive, check_workers

with lazy_imports():
    from torch import set_num_threads

    from omad.applications.service.answers import Answers
    from omad.applications.service.app import make_app
    from omad.applications.service.batching import Batcher
    from omad.applications.service.bounded import Bounds, Service
    from omad.applications.service.server import run_server

NEEDED = ("fastapi", "uvicorn", "python_multipart")


@dataclass(frozen=True, kw_only=True)
class Serve(CategoriesCommand):
    """Answer over HTTP: a depth image sent to /estimate gets the JSON of omad estimate, or its page.

    SIGTERM and Ctrl-C end it when what it has begun is answered. It needs the extra omad[serve].
    """

    host: str = LOCAL
    """Address to listen at. Whoever reaches another one may have images estimated."""
    port: int = 8000
    """0: any free one. The address is printed."""
    workers: int = 0
    """Threads; 0: one a core."""
    batch: int = 16
    """Images that go through the network together, where so many wait."""
    queue: int = 64
    """Requests at a time; further ones are told to come again (503)."""
    body_bytes: int = 64_000_000
    """Of a request; larger ones are refused (413)."""
    held_bytes: int = 500_000_000
    """Of all requests that are here; further ones are told to come again (503)."""
    seconds: float = 30.0
    """For a request to be sent (408) and answered (504)."""

    def run(self) -> Answer:
        check_positive(batch=self.batch, queue=self.queue, body_bytes=self.body_bytes, seconds=self.seconds)
        check_positive(held_bytes=self.held_bytes)
        workers = check_workers(self.workers)
        if missing := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
            raise InputError(f"omad serve needs {missing[0]}; pip install 'omad[serve]'")
        port = free_port(self.host, self.port)
        url = f"http://{self.host}:{port}"
        tell("omad: loading weights")
        answers = Answers([estimator for _, estimator in self.estimators()])
        free_port(self.host, port)  # still: loading took seconds, in which another program may have come
        set_num_threads(1)  # its threads are the workers
        batcher = Batcher(answers, workers, self.batch)
        service = Service(answers, batcher, Bounds(self.queue, self.body_bytes, self.held_bytes, self.seconds))
        try:
            run_server(make_app(service), self.host, port, self.seconds, lambda: _greet(url))
        finally:
            batcher.close()
        statuses = {str(status): count for status, count in sorted(service.metrics.statuses.items())}
        return Answer({"url": url, "requests": sum(service.metrics.statuses.values()), "by_status": statuses})


def _greet(url: str) -> None:
    tell(f"omad: {url} (Ctrl-C ends it)")
