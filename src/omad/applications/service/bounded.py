"""Requests are taken on within bounds, and counted."""

import asyncio
import time
from dataclasses import dataclass, replace

from starlette.requests import Request

from omad.common.errors import InputError

from .answers import Answers
from .asked import Asked, in_fields
from .batching import Batcher
from .form import Gone, TooLarge, read_form
from .metrics import Metrics
from .reply import Reply

GONE = 499
"""Who asked is not there any more, and gets no answer: a status for the counts, as nginx has it."""


@dataclass(frozen=True)
class Bounds:
    """What the service takes on."""

    queue: int = 64
    """Requests at a time, from their first line to their answer; further ones are turned away with 503."""
    body_bytes: int = 64_000_000
    """Of a request; a larger one is refused with 413."""
    seconds: float = 30.0
    """For a request: 408 where its body is not there by then, 504 where the answer is not."""


class Service:
    """Takes requests on within bounds, and counts them."""

    def __init__(self, answers: Answers, batcher: Batcher, bounds: Bounds) -> None:
        """``batcher`` works with ``answers``."""
        self.answers, self.batcher, self.bounds = answers, batcher, bounds
        self.metrics, self.inside = Metrics(), 0

    async def estimate(self, request: Request) -> Reply:
        """What is sent back for one request."""
        began = time.perf_counter()
        if self.inside >= self.bounds.queue:
            reply = Reply.failed(503, f"{self.inside} requests are here already; try again")
        else:
            self.inside += 1
            try:
                reply = await self._within_time(request)
            finally:
                self.inside -= 1
        self.metrics.add(reply.status, time.perf_counter() - began)
        return reply

    async def _within_time(self, request: Request) -> Reply:
        most, seconds, asked = self.bounds.body_bytes, self.bounds.seconds, None
        try:
            async with asyncio.timeout(seconds):
                form = await read_form(request, most)
                asked = Asked.of(form)
                if "format" not in form and "text/html" in request.headers.get("accept", ""):
                    asked = replace(asked, format="html")
                self.answers.check(asked)
                return await self.batcher(asked)
        except InputError as error:
            return Reply.failed(400, in_fields(str(error)))
        except Gone:
            return Reply.failed(GONE, "the body ended too early; send it anew")
        except TooLarge:
            return Reply.failed(413, f"the body has more than {most} bytes; send a smaller image")
        except TimeoutError:
            status, what = (408, "the body was not there") if asked is None else (504, "there was no answer")
            return Reply.failed(status, f"{what} after {seconds:g} s")
