"""Gravity, where it is known, and bases that lie before it in every way."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from omad.estimation.known import Known
from omad.model.fitting.state import State
from omad.objects.category_file import get_category


def test_every_base_is_set_upright():
    """Those that stand exactly on their heads, too."""
    category = get_category("laptop")
    turns = [np.eye(3), np.diag([1.0, -1.0, -1.0]), *Rotation.random(20, random_state=0).as_matrix()]
    for gravity in (np.array([0.0, 1.0, 0.0]), np.array([0.3, 0.9, -0.2])):
        pose = torch.eye(4, dtype=torch.float64).repeat(len(turns), 1, 1)
        pose[:, :3, :3] = torch.tensor(np.stack(turns))
        start = State(torch.zeros(len(turns), 10).double(), torch.zeros(len(turns), 1).double(), pose)
        found = Known(gravity=gravity).apply_to(start, category).T_camera_base[:, :3, :3]
        np.testing.assert_allclose(
            -found[:, :, 1], np.tile(gravity / np.linalg.norm(gravity), (len(turns), 1)), atol=1e-7
        )
        np.testing.assert_allclose(found @ found.mT, np.tile(np.eye(3), (len(turns), 1, 1)), atol=1e-9)
