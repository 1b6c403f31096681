"""What users hold in lists, sets and dictionaries: compared by identity where it holds arrays."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from omad.applications.detection.detector import Detection
from omad.applications.retrieval.signature import Space
from omad.estimation.known import Near
from omad.model.fitting.state import State, Targets
from omad.sensing.camera_files import CameraFile
from omad.sensing.foreign.bags import RecordedFrame
from omad.sensing.observation import Observation

CLOUD = Observation(np.zeros((60, 3), np.float32))


@pytest.mark.parametrize(
    "one",
    [
        CameraFile(np.eye(3)),
        Detection(CLOUD, {None: 1.0}, None, {}),
        Space("prior", "laptop", "beta", np.eye(3)),
        RecordedFrame("1", 0.0, np.zeros((2, 2)), None),
        Near(np.eye(4), np.zeros(2), np.zeros(3), np.eye(3)),
        State(torch.zeros(2, 3), torch.zeros(2, 1), torch.eye(4).repeat(2, 1, 1)),
        Targets(torch.zeros(2, 4, 3), torch.ones(2, 4)),
    ],
    ids=lambda one: type(one).__name__,
)
def test_the_same_is_found_and_a_copy_is_another(one):
    other = replace(one)
    assert one != other
    assert [other, one].index(one) == 1
    assert one not in [other]
    assert len({one, other, one}) == 2
