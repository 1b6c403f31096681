"""Options of a request to the service count as those of the command line do."""

import io
import json
from functools import cache

import numpy as np

import omad
from helpers.command_line import laptop_view
from helpers.service import INTRINSICS
from omad.applications.service.answers import Answers
from omad.applications.service.asked import Asked


@cache
def laptop() -> np.ndarray:
    """(480, 640) uint16 millimetres."""
    return np.rint(laptop_view().depth * 1000).astype(np.uint16)


def stored(write, *args, **named) -> bytes:
    file = io.BytesIO()
    write(file, *args, **named)
    return file.getvalue()


def fields(**more: bytes) -> dict[str, bytes]:
    sent = {"depth": stored(np.save, laptop() * np.float32(0.001)), "intrinsics": INTRINSICS}
    return {**sent, "category": b"laptop", "checks": b"few", **more}


def test_stray_points_are_dropped_on_request():
    depth = (laptop() * 0.001).astype(np.float32)
    rows, columns = np.nonzero(depth)
    depth[rows[:1000:20], columns[:1000:20]] *= 1.5
    sent = {"depth": stored(np.save, depth), "mask": stored(np.save, depth > 0)}
    for told in ("true", "false"):
        seen = Asked.of(fields(**sent, drop_flying=told.encode())).observation(lambda frame, box: frame)
        expected = omad.Observation.from_depth(depth, (600, 600, 319.5, 239.5), drop_flying=told == "true")
        np.testing.assert_allclose(seen.points, expected.points, atol=1e-6)
    assert seen.points[:, 2].max() > 1.2 * np.median(seen.points[:, 2])  # the strays, which stayed


def test_a_box_counts_more_than_the_mask_in_the_images_own_file():
    """As of omad estimate: whoever draws a box means what is in it, not what the file says."""
    depth, told = laptop() * np.float32(0.001), []
    own = stored(np.savez, depth=depth, mask=np.arange(640) < np.full((480, 1), 330))
    asked = Asked.of(fields(depth=own, box=b"300,0,640,480"))
    seen = asked.observation(lambda frame, box: told.append(box) or frame.part(frame.inside(box)))
    assert told == [[300, 0, 640, 480]]
    assert len(seen.points) == np.count_nonzero(depth[:, 300:])


def test_the_page_warns_of_what_the_record_warns_of():
    """Of what a box cuts off, say."""
    depth = laptop_view().depth
    rows, columns = np.nonzero(depth)
    wall = np.where(depth > 0, depth, np.float32(1.5 * depth.max()))
    box = f"{columns.min()},{rows.min()},{int(np.quantile(columns, 0.7))},{rows.max() + 1}".encode()
    sent, answers = (
        fields(depth=stored(np.save, wall), box=box),
        Answers([omad.Estimator.from_pretrained("laptop", "cpu")]),
    )
    [record], [page] = (list(answers([Asked.of(sent | {"format": kind})])) for kind in (b"json", b"html"))
    warnings = json.loads(record.body)["warnings"]
    assert any("lies outside of it" in warning for warning in warnings)
    for warning in warnings:
        assert warning.split(":")[0].encode() in page.body


def test_few_checks_take_no_further_estimates():
    """With one category, and with any."""
    calls = []

    class Counted(omad.Estimator):
        def first_answers(self, *seen, **named):
            calls.append(len(seen[0]))
            return super().first_answers(*seen, **named)

    answers = Answers([Counted.from_pretrained("laptop", "cpu")])
    for category in (b"laptop", b"auto"):
        made = []
        for checks in (b"few", b"all"):
            calls.clear()
            [reply] = answers([Asked.of(fields(checks=checks, category=category, mask=stored(np.save, laptop() > 0)))])
            assert reply.status == 200
            assert json.loads(reply.body)["seconds"]["read"] > 0
            made.append(sum(calls))
        assert made[0] <= 1 < made[1]
