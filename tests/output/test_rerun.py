"""Recordings for Rerun: axes, camera and clouds are where they are."""

from unittest.mock import MagicMock

import numpy as np
import pytest

import omad
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.objects.category_file import get_category
from omad.output.frame import Frame
from omad.output.rerun import log_frame


@pytest.mark.parametrize("name", ["laptop", "drawer"])
def test_a_recording_has_axes_and_camera_where_they_are(name):
    category = get_category(name)
    model = generate(category, 0, "test")
    view = standard_view(model, category, (0, 1000))
    observation = view.observation()
    estimate = omad.Estimator.from_pretrained(name, "cpu")(observation)
    rr, T = MagicMock(), np.eye(4)
    T[:3] = [[0, 0, 1, 0.3], [-1, 0, 0, 0.2], [0, -1, 0, 1.0]]
    log_frame(rr, MagicMock(), observation, estimate, static=False, frame=Frame.of(T))
    for call, joint, part in zip(rr.Arrows3D.call_args_list, estimate.joints, (1, 2, 3), strict=False):
        [start], [vector] = call.kwargs["origins"], call.kwargs["vectors"]
        assert vector / np.linalg.norm(vector) == pytest.approx(joint.axis)
        if joint.pivot is None:  # from inside the drawer
            inside = np.linalg.inv(estimate.T_camera_part[part]) @ [*start, 1.0]
            low, high = model.part_boxes()[part]
            assert (inside[:3] > low - 0.03).all()
            assert (inside[:3] < high + 0.03).all()
        else:  # as far before its pivot as behind
            assert start + vector / 2 == pytest.approx(joint.pivot)
    [camera] = rr.Transform3D.call_args_list
    assert np.array_equal(camera.kwargs["mat3x3"], T[:3, :3])
    assert np.array_equal(camera.kwargs["translation"], T[:3, 3])
    [pinhole] = rr.Pinhole.call_args_list
    assert pinhole.kwargs["resolution"] == [640, 480]
    assert [joint.args[0] for joint in rr.Scalars.call_args_list] == [joint.state for joint in estimate.joints]
    [cloud] = [c for c in rr.Points3D.call_args_list if len(c.args[0]) == len(observation.points)]
    assert len(cloud.kwargs["colors"]) == len(observation.points)
