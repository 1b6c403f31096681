"""Answers that go on towards their surfaces: so far as their shares say, and in a mirror as well as before it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import omad
from helpers.categories import DISHWASHER, EYEGLASSES
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimate import Estimate
from omad.geometry.rigid import carry
from omad.model.surfaces.shares import Shares
from omad.model.surfaces.surfaces import Surfaces


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    view = standard_view(generate(DISHWASHER, 2, "test"), DISHWASHER, (5, 2))
    return omad.Estimator.from_pretrained("dishwasher", "cpu")(view.observation())


def sharing(estimate: Estimate, base: float, door: float) -> Estimate:
    """The estimate with such shares, and errors that were halved where anything was taken."""
    surfaces, taken = estimate.surfaces, np.array([base, door])
    assert surfaces is not None
    errors = np.stack([np.full(2, 0.1), np.full(2, 0.2), np.where(taken > 0, 0.05, 0.1)])
    bank = replace(surfaces.bank, shares=Shares(taken, errors, 50))
    return replace(estimate, surfaces=Surfaces(surfaces._prior, estimate.category, lambda: bank))


def test_all_of_the_way_is_where_the_surface_lies(estimate):
    found = sharing(estimate, 1.0, 1.0).to_surface()
    assert np.allclose(found.T_camera_part, estimate.surface.placed.T_camera_part)
    assert found.joints[0].state == pytest.approx(estimate.surface.placed.states[0])
    for joint, axis in zip(found.joints, estimate.surface.placed.axes, strict=True):
        assert np.allclose(joint.axis, axis)
    assert not np.allclose(found.joints[0].state, estimate.joints[0].state, atol=1e-4)
    apart = np.linalg.norm(found.keypoints - found.observed_keypoints, axis=1)
    assert found.residual == pytest.approx(np.sqrt(np.square(apart).mean()))
    assert found.residual > estimate.residual + 1e-5  # which is the least there is
    assert found.to_surface() is found


@pytest.mark.filterwarnings("error")
def test_each_goes_its_own_share_of_the_way(estimate):
    found, fit = sharing(estimate, 0.25, 0.5).to_surface(), estimate.surface.placed
    assert found.joints[0].state == pytest.approx(0.5 * (estimate.joints[0].state + fit.states[0]))
    T, start, end = found.T_camera_base, estimate.T_camera_base, fit.T_camera_part[0]
    assert np.allclose(T[:3, 3], 0.75 * start[:3, 3] + 0.25 * end[:3, 3])
    turns = [Rotation.from_matrix(to[:3, :3] @ start[:3, :3].T).as_rotvec() for to in (T, end)]
    assert np.allclose(turns[0], 0.25 * turns[1])
    part_of = np.array(DISHWASHER.part_of_keypoint)
    for part, T in enumerate(found.T_camera_part):
        of_it = part_of == part
        assert np.allclose(found.keypoints[of_it], carry(T, found.canonical_keypoints[of_it]))


def test_what_is_not_taken_stays_and_deviations_shrink_as_errors_did(estimate):
    found = sharing(estimate, 0.0, 0.5).to_surface()
    assert np.allclose(found.T_camera_base, estimate.T_camera_base)
    assert np.allclose(found.beta, estimate.beta)
    assert found.joints[0].state_std == pytest.approx(0.5 * estimate.joints[0].state_std)
    shrunk = np.sqrt(found.covariance.diagonal() / estimate.covariance.diagonal())
    assert shrunk[:6] == pytest.approx(1)
    assert shrunk[6] == pytest.approx(0.5)
    assert np.allclose(found.base_std, estimate.base_std)
    closer = sharing(estimate, 0.5, 0.5).to_surface()
    shrunk = np.sqrt(closer.covariance.diagonal() / estimate.covariance.diagonal())[:6]
    assert shrunk == pytest.approx(0.5)
    assert np.allclose(closer.base_std, shrunk * estimate.base_std)
    assert found.seconds["surface"] > 0
    assert sharing(estimate, 0.0, 0.0).to_surface().seconds == estimate.seconds


def test_in_a_mirror_it_goes_the_same_way(estimate):
    shared = sharing(estimate, 0.5, 0.5)
    there, here = shared.in_mirror().to_surface(), shared.to_surface()
    assert there.of_other_hand
    assert np.allclose(there.in_mirror().T_camera_part, here.T_camera_part)
    assert np.allclose(there.in_mirror().keypoints, here.keypoints)
    assert there.joints[0].state == pytest.approx(here.joints[0].state)


def test_without_surfaces_or_shares_there_is_no_way(estimate):
    bare = replace(estimate, surfaces=None)
    unmeasured = sharing(estimate, 0, 0)
    assert unmeasured.surfaces is not None
    bank = replace(unmeasured.surfaces.bank, shares=None)
    unmeasured = replace(estimate, surfaces=Surfaces(unmeasured.surfaces._prior, estimate.category, lambda: bank))
    for each in (bare, unmeasured):
        with pytest.raises(InputError, match=r"to_surface: .*run omad train surface --category dishwasher"):
            each.to_surface()
    own = replace(bare, category=replace(DISHWASHER, name="pedal_bin"))
    with pytest.raises(InputError, match=r"train surface --category SPEC --weights W --prior P --source S.*pedal_bin"):
        own.to_surface()


def test_without_points_of_the_object_nothing_changes(estimate):
    bare = sharing(estimate, 0.5, 0.5).without_labels()
    assert bare.to_surface() is bare
    assert "surface" not in bare.to_surface().seconds


def test_where_a_surface_is_placed_its_hinges_are_where_its_parts_turn():
    view = standard_view(generate(EYEGLASSES, 2, "test"), EYEGLASSES, (5, 2))
    estimate = omad.Estimator.from_pretrained("eyeglasses", "cpu")(view.observation())
    placed = estimate.surface.placed
    base_camera = np.linalg.inv(placed.T_camera_part[0])
    for joint, (parent, axis, pivot) in enumerate(
        zip(EYEGLASSES.tree.parents, placed.axes, placed.pivots, strict=True)
    ):
        assert parent == 0
        # a point of the hinge is at one place, whichever of the two parts it is taken to be on
        rest = carry(base_camera, np.stack([pivot, pivot + 0.1 * axis]))
        assert carry(placed.T_camera_part[joint + 1], rest) == pytest.approx(np.stack([pivot, pivot + 0.1 * axis]))
