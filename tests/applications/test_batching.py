"""Requests that wait for a worker, with stand-ins for the estimator: late ones, and work that fails."""

import asyncio
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("fastapi", reason="needs a server: pip install 'omad[serve]'")

from helpers.service import FORM, form
from omad.applications.service.batching import Batcher
from omad.applications.service.bounded import Bounds, Service
from omad.applications.service.reply import Reply


def test_work_that_fails_is_told_of_in_the_log(capsys):
    async def ask():
        batcher = Batcher(lambda batch: [][len([*batch])], workers=1, batch=8)
        asked = SimpleNamespace(category="laptop")
        reply = await batcher(asked)  # pyright: ignore[reportArgumentType]
        batcher.close()
        return reply

    assert asyncio.run(ask()).status == 500
    assert "IndexError" in capsys.readouterr().err


def test_who_is_not_answered_in_time_is_told_so_and_others_go_on():
    """With a stand-in for the estimator that takes as long as it is told to."""

    class Answers:
        categories = ("laptop",)
        batches: list[int] = []  # noqa: RUF012

        def check(self, asked):
            pass

        def __call__(self, batch):
            batch = list(batch)
            self.batches.append(len(batch))
            time.sleep(max(float(asked.depth) for asked in batch))
            return [Reply.of(200, {"depth": asked.depth.decode()}) for asked in batch]

    class Request:
        def __init__(self, seconds: str) -> None:
            self.body = form({"category": b"laptop", "depth": seconds.encode(), "intrinsics": b"1"})
            self.headers = {"content-type": FORM, "Content-Type": FORM}

        async def stream(self):
            yield self.body

    async def drill():
        answers = Answers()
        batcher = Batcher(answers, workers=1, batch=8)
        service = Service(answers, batcher, Bounds(queue=8, seconds=0.5))
        late = asyncio.create_task(service.estimate(Request("1.0")))
        await asyncio.sleep(0.2)
        waiting = [asyncio.create_task(service.estimate(Request("0.0"))) for _ in range(7)]
        await asyncio.sleep(0)
        turned_away = await service.estimate(Request("0.0"))
        assert turned_away.status == 503
        assert [(await each).status for each in (late, *waiting)] == [504] * 8
        assert (service.inside, batcher.waiting) == (0, 0)
        await asyncio.sleep(0.6)
        again = [asyncio.create_task(service.estimate(Request("0.1"))) for _ in range(5)]
        assert [(await each).status for each in again] == [200] * 5
        batcher.close()
        return answers.batches

    # those that were told so are not worked on; of five the first goes alone, the others wait and go together
    assert asyncio.run(drill()) == [1, 1, 4]


def test_bodies_beyond_what_is_held_are_turned_away():
    """Those that a worker has count for as long as it has them, although nobody waits any more."""

    class Answers:
        categories = ("laptop",)

        def check(self, asked):
            pass

        def __call__(self, batch):
            batch = list(batch)
            time.sleep(max(float(asked.depth) for asked in batch))
            return [Reply.of(200, {}) for _ in batch]

    class Request:
        headers = {"content-type": FORM, "Content-Type": FORM}  # noqa: RUF012

        def __init__(self, seconds: str) -> None:
            self.body = form({"category": b"laptop", "depth": seconds.encode().ljust(5000), "intrinsics": b"1"})

        async def stream(self):
            for start in range(0, len(self.body), 1000):
                yield self.body[start : start + 1000]
                await asyncio.sleep(0)

    async def drill():
        answers = Answers()
        batcher = Batcher(answers, workers=1, batch=8)
        service = Service(answers, batcher, Bounds(8, body_bytes=8000, held_bytes=8000, seconds=0.5))
        together = [asyncio.create_task(service.estimate(Request("0.0"))) for _ in range(2)]
        assert 503 in [(await each).status for each in together]
        late = asyncio.create_task(service.estimate(Request("1.5")))
        await asyncio.sleep(0.2)
        assert (await service.estimate(Request("0.0"))).status == 503
        assert (await late).status == 504
        assert (await service.estimate(Request("0.0"))).status == 503
        await asyncio.sleep(1.5)
        assert service.held == 0
        assert (await service.estimate(Request("0.0"))).status == 200
        batcher.close()

    asyncio.run(drill())


def test_an_answer_waits_for_no_other_of_its_batch_and_who_is_late_is_passed_over():
    begun = []

    def answer(batch):
        for asked in batch:
            begun.append(asked.name)
            time.sleep(asked.seconds)
            yield Reply.of(200, {})

    async def ask(batcher, name, seconds, within):
        asked = SimpleNamespace(category="laptop", name=name, seconds=seconds, size=1)
        began = time.monotonic()
        await asyncio.wait_for(batcher(asked), within)
        return time.monotonic() - began

    async def drill():
        batcher = Batcher(answer, workers=1, batch=8)
        first = asyncio.create_task(ask(batcher, "first", 0.1, 5.0))
        await asyncio.sleep(0.05)  # the others wait together
        asked = (("quick", 0.1, 5.0), ("slow", 1.0, 5.0), ("late", 0.1, 0.6), ("last", 0.1, 5.0))
        rest = [asyncio.create_task(ask(batcher, *one)) for one in asked]
        quick, _, late, _ = await asyncio.gather(*rest, return_exceptions=True)
        assert await first < 1
        assert quick < 0.8
        assert isinstance(late, TimeoutError)
        await asyncio.sleep(0.1)  # until the worker is free
        assert (batcher.held, batcher.waiting, batcher.batches) == (0, 0, 2)
        batcher.close()

    asyncio.run(drill())
    assert begun == ["first", "quick", "slow", "last"]


def test_who_came_first_is_answered_first_though_not_all_fit_into_a_batch():
    begun = []

    def answer(batch):
        for asked in batch:
            begun.append(asked.name)
            time.sleep(0.02)
            yield Reply.of(200, {})

    async def drill():
        batcher = Batcher(answer, workers=1, batch=2)
        names = ["a0", "b0", "a1", "a2", "a3", "b1", "a4"]
        asked = [SimpleNamespace(category=name[0], name=name, size=1) for name in names]
        await asyncio.gather(*map(batcher, asked))
        batcher.close()

    asyncio.run(drill())
    # after the first, which goes alone, batches are of the category of the oldest that waits
    assert begun == ["a0", "b0", "b1", "a1", "a2", "a3", "a4"]
