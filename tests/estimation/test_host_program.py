"""The program that uses OMAD: what it does to answers harms no other, and what is its own stays as it was."""

import pickle
import warnings
from functools import cache

import numpy as np
import torch

import omad
from helpers.command_line import laptop_view


@cache
def estimator() -> omad.Estimator:
    return omad.Estimator.from_pretrained("laptop", "cpu")


def test_what_callers_do_to_an_answer_harms_no_other():
    view = laptop_view().observation()
    before = estimator()(view)
    faces = [part.mesh.faces.copy() for part in before.parts]
    for part in before.parts:
        part.mesh.faces[:] += 1
    place = before.T_camera_base
    place[:3, 3] *= 1000
    assert np.abs(before.T_camera_base[:3, 3]).max() < 10
    for part, kept in zip(estimator()(view).parts, faces, strict=True):
        assert np.array_equal(part.mesh.faces, kept)


def test_who_keeps_one_answer_keeps_nothing_of_its_batch():
    view = laptop_view().observation()
    kept, _ = estimator()([view, view])
    for array in (kept.covariance, kept.labelled.logits, kept.signals.image, kept.signals.joint, kept.signals.pooled):
        assert array.base is None


def test_the_callers_random_numbers_stay_as_they_were():
    torch.manual_seed(3)
    before = torch.get_rng_state()
    loaded = omad.Estimator.from_pretrained("laptop", "cpu")
    _ = loaded(laptop_view().observation()).surface
    _ = pickle.loads(pickle.dumps(loaded)).surfaces
    assert torch.equal(torch.get_rng_state(), before)


def test_what_is_known_may_be_read_only():
    gravity = np.array([0.0, 1.0, 0.0])
    gravity.setflags(write=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        estimator()(laptop_view().observation(), omad.Known(gravity=gravity))
