"""Requests are taken on within bounds, and counted."""

import asyncio
import time
from dataclasses import dataclass, replace

from starlette.requests import Request

from omad.common.errors import InputError

from .answers import Answers
from .asked import Asked, in_fields
from .batching import Batcher
from .form import Full, Gone, TooLarge, read_form
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
    held_bytes: int = 500_000_000
    """Of the bodies of all requests, those that are worked on included; what is beyond is turned away with 503. One
    body of the largest size always may come."""
    seconds: float = 30.0
    """For a request: 408 where its body is not there by then, 504 where the answer is not."""


class Service:
    """Takes requests on within bounds, and counts them."""

    def __init__(self, answers: Answers, batcher: Batcher, bounds: Bounds) -> None:
        """``batcher`` works with ``answers``."""
        self.answers, self.batcher, self.bounds = answers, batcher, bounds
        self.metrics, self.inside, self._coming = Metrics(), 0, 0

    @property
    def held(self) -> int:
        """Bytes of bodies that are here."""
        return self._coming + self.batcher.held

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
                form = await self._form(request)
                asked = Asked.of(form)
                if "format" not in form and "text/html" in request.headers.get("accept", ""):
                    asked = replace(asked, format="html")
                self.answers.check(asked)
                return await self.batcher(asked)
        except InputError as error:
            return Reply.failed(400, in_fields(str(error)))
        except Gone:
            return Reply.failed(GONE, "the body ended too early; send it anew")
        except Full:
            return Reply.failed(503, f"{self.held} bytes of requests are here already; try again")
        except TooLarge:
            return Reply.failed(413, f"the body has more than {most} bytes; send a smaller image")
        except TimeoutError:
            status, what = (408, "the body was not there") if asked is None else (504, "there was no answer")
            return Reply.failed(status, f"{what} after {seconds:g} s")

    async def _form(self, request: Request) -> dict[str, bytes]:
        mine, most = 0, max(self.bounds.held_bytes, self.bounds.body_bytes)

        def take(count: int) -> None:
            nonlocal mine
            if self.held + count > most:
                raise Full
            mine += count
            self._coming += count

        try:
            return await read_form(request, self.bounds.body_bytes, take)
        finally:
            self._coming -= mine  # from here on it is the batcher's
