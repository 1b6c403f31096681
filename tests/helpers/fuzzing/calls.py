"""What a program may call, with arguments of all kinds."""

import datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from omad.applications.bulk.stream import Frame, estimate_stream
from omad.applications.explorer.fitting import FitRequest, fit_file
from omad.applications.explorer.places import Places, plain_name
from omad.applications.retrieval.index import Entry, ShapeIndex
from omad.applications.retrieval.signature import Signature, Space
from omad.applications.tracking.tracker import Tracker
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.estimation.known import Known
from omad.model.checkpoint import find_weights
from omad.objects.category_file import get_category
from omad.sensing.camera_files import read_camera, read_transform
from omad.sensing.depth_files import read_cloud, read_depth, read_mask
from omad.sensing.masks import as_mask
from omad.sensing.observation import Observation

from ..command_line import laptop_view
from .spoiling import ODD, odd_array
from .trial import Call, Spoiler


def _changed(good: Any, rng: np.random.Generator) -> Any:
    return odd_array(np.asarray(good), rng) if isinstance(good, np.ndarray | list | tuple | float | int) else None


ARRAYS = (Spoiler(_changed),) * 30
OBJECTS = (
    *ODD,
    object(),
    len,
    b"bytes",
    datetime.date(2000, 1, 1),
    {1, 2},
    range(3),
    3 + 4j,
    np.float64("nan"),
    np.array(None),
    np.array([]),
    torch.zeros(3, requires_grad=True),
    torch.tensor(float("nan")),
    np.ma.masked_all(3),
    Path("/nowhere"),
    np.zeros((3, 3)),
    np.full((4, 4), np.nan),
    np.zeros((0, 3)),
    "laptop",
    Ellipsis,
    Exception("x"),
)


@cache
def _estimator() -> Estimator:
    return Estimator.from_pretrained("laptop", "cpu")


def _numbers(estimate: Estimate) -> np.ndarray:
    joints = [[joint.state, joint.state_std, *joint.axis] for joint in estimate.joints]
    return np.concatenate([np.ravel(joints), estimate.T_camera_base.ravel(), estimate.beta, estimate.keypoints.ravel()])


def calls() -> list[Call]:
    """All of them."""
    view = laptop_view()
    depth, mask = view.depth[::4, ::4], view.depth[::4, ::4] > 0
    K = np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]])
    observation = Observation.from_depth(depth, K, mask)
    category = get_category("laptop")
    beta, states = np.zeros(category.basis_size), np.zeros(len(category.joints))
    any_kind = OBJECTS + ARRAYS

    def known(beta: Any, states: Any, gravity: Any) -> np.ndarray:
        return _numbers(_estimator()(observation, Known(beta, states, gravity)))

    def from_depth(depth: Any, K: Any, mask: Any, box: Any, segment: Any) -> np.ndarray:
        return Observation.from_depth(depth, K, mask, box, segment).points

    def from_points(points: Any, segment: Any) -> np.ndarray:
        return Observation.from_points(points, segment).points

    def estimated(points: Any) -> np.ndarray:
        return _numbers(_estimator()(Observation.from_points(points)))

    def together(first: Any, second: Any) -> np.ndarray:
        return _numbers(_estimator()([observation, observation], T_world_camera=[first, second])[0])

    def tracked(time: Any, later: Any, second: Any) -> np.ndarray:
        tracker = Tracker(_estimator())
        tracker(observation, time)
        found = tracker(second, later).estimate
        return np.zeros(1) if found is None else _numbers(found)

    def indexed(beta: Any, covariance: Any, count: Any, name: Any) -> np.ndarray:
        index = ShapeIndex(Space.of(_estimator().net.prior, category, "keypoints"))
        prior = index.space.prior
        index.add([Signature(prior, beta, covariance)], [Entry(name)])
        return np.array([hit.distance for hit in index.search(Signature(prior, beta, covariance), count)])

    def streamed(frames: Any, workers: Any, batch: Any) -> float:
        return float(len([*estimate_stream(_estimator(), frames, workers, batch)]))

    def fitted(*texts: Any) -> float:
        request = FitRequest.of_texts(*texts, Places((Path("/nowhere"),)))
        return fit_file(_estimator(), request).estimate.residual

    def configured(samples: Any, near: Any, seed: Any, batch: Any) -> EstimatorConfig:
        return EstimatorConfig(samples=samples, near_samples=near, seed=seed, batch=batch)

    pose, page = (
        np.eye(4),
        tuple(text for text in ODD if isinstance(text, str)) + ("nan", "1,2,3,4", "-1", "~", "1e999"),
    )
    return [
        Call("known", known, (beta, states, np.array([0.0, 1.0, 0.0])), any_kind),
        Call("from depth", from_depth, (depth, K, mask, [5, 5, 150, 110], None), any_kind),
        Call("from points", from_points, (observation.points, None), any_kind),
        Call("estimator", _estimator(), (observation,), OBJECTS),
        Call("estimate points", estimated, (observation.points,), ARRAYS),
        Call("several views", together, (pose, pose), any_kind),
        Call("tracker", tracked, (0.0, 0.1, observation), OBJECTS),
        Call("index", indexed, (beta, np.eye(len(beta)), 1, "a"), any_kind),
        Call("stream", streamed, ([Frame.of_depth("a", depth, K, mask)], 1, 1), OBJECTS),
        Call("configuration", configured, ((1, 3), 2, 0, 8), OBJECTS),
        Call("explorer request", fitted, ("d.png", "1,2,3,4", "", "", False, ""), page),
        Call("explorer name", plain_name, ("a.png",), page),
        Call("mask", as_mask, (mask,), any_kind),
        *(
            Call(f"path of {read.__name__}", read, (Path("/nowhere"),), OBJECTS)
            for read in (read_depth, read_cloud, read_mask, read_camera, get_category, find_weights)
        ),
        Call("path of a transform", lambda path: read_transform(path, "T_a_b"), (Path("/nowhere"),), OBJECTS),
    ]
