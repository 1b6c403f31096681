"""Requests wait for a free worker; those that wait for the same category are answered together.

Nothing waits for a batch to fill: a worker that is free takes its share of what is there. An answer goes out when it is
made, though others of its batch are not.
"""

import asyncio
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from traceback import print_exception

import torch

from omad.objects.builtin import AUTO

from .asked import Asked
from .reply import Reply


@dataclass(frozen=True, eq=False)
class _Waiting:
    asked: Asked
    reply: asyncio.Future[Reply]


class Batcher:
    """For one event loop."""

    def __init__(self, answer: Callable[[Iterator[Asked]], Iterable[Reply]], workers: int, batch: int) -> None:
        """``answer`` is called in one of ``workers`` threads, with up to ``batch`` requests of one category: those that
        somebody still waits for when it comes to them. It answers them in their order."""
        self._answer, self._batch, self._idle = answer, batch, workers
        self._waiting: deque[_Waiting] = deque()
        self._taken: set[_Waiting] = set()
        self._pool = ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,))
        self.batches = 0
        """Handed to a worker so far."""

    @property
    def waiting(self) -> int:
        """Requests that no worker has taken yet."""
        return len(self._waiting)

    @property
    def held(self) -> int:
        """Bytes of what waits and of what a worker has, whether or not somebody still waits for it."""
        return sum(each.asked.size for each in (*self._waiting, *self._taken))

    async def __call__(self, asked: Asked) -> Reply:
        """Who is cancelled while it waits is never worked on."""
        one = _Waiting(asked, asyncio.get_running_loop().create_future())
        self._waiting.append(one)
        self._hand_out()
        try:
            return await one.reply
        finally:
            if not one.reply.done() or one.reply.cancelled():
                self._waiting = deque(each for each in self._waiting if each is not one)

    def close(self) -> None:
        """End the threads; what waits is not worked on."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _hand_out(self) -> None:
        loop = asyncio.get_running_loop()
        while self._idle and self._waiting:
            category = self._waiting[0].asked.category
            # categories are found one view at a time, so that the first of several would only wait for the last
            share = 1 if category == AUTO else min(self._batch, -(-len(self._waiting) // self._idle))
            taken = [each for each in self._waiting if each.asked.category == category][:share]
            self._waiting = deque(each for each in self._waiting if each not in taken)
            self._taken.update(taken)
            self._idle -= 1
            self.batches += 1
            work = loop.run_in_executor(self._pool, self._work, taken, loop)
            work.add_done_callback(partial(self._done, taken))

    def _work(self, taken: list[_Waiting], loop: asyncio.AbstractEventLoop) -> None:
        """In a worker's thread."""
        begun = deque[_Waiting]()

        def wanted() -> Iterator[Asked]:
            for each in taken:
                if not each.reply.done():
                    begun.append(each)
                    yield each.asked

        for reply in self._answer(wanted()):
            loop.call_soon_threadsafe(self._give, begun.popleft(), reply)

    def _give(self, one: _Waiting, reply: Reply) -> None:
        self._taken.discard(one)
        if not one.reply.done():
            one.reply.set_result(reply)

    def _done(self, taken: list[_Waiting], work: asyncio.Future[None]) -> None:
        self._idle += 1
        if not work.cancelled() and work.exception() is not None:
            print_exception(work.exception(), file=sys.stderr)
        for each in taken:
            self._give(each, Reply.failed(500, "the work failed"))  # where it has no answer
        self._hand_out()
