"""What a network says of a cloud's mirror image, told of the cloud.

An object that is its own mirror image should be seen alike in either. What a network gets wrong of the two differs, so
that the mean is nearer than that of as many looks at the cloud alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from omad.geometry.transforms import MIRROR_X
from omad.model.omadnet import Prediction
from omad.model.prior import mirror_map
from omad.objects.category import Category


@dataclass(frozen=True)
class Mirror:
    """The plane x = 0 of canonical space, in which objects of a category are their own images."""

    keypoints: Tensor
    """(M,) whose image each keypoint is."""
    labels: Tensor
    """(K,) the same of parts, or (K + 1,) with points outside the object, which stay so."""
    joints: Tensor
    """(J,) the same of joints."""
    signs: Tensor
    """(J,) of the states of images."""

    @classmethod
    def of(cls, category: Category, tells_outside: bool) -> Mirror | None:
        """None where an image is no object of the category, or one with another beta: where a part has no ``mirror``,
        or a joint moves another way in it."""
        parts = None if category.either_hand else category.part_images
        if parts is None:
            return None
        images = np.array(parts[1:]) - 1
        signs = category.signs_of_images(images)
        learned = mirror_map(category)
        partner = np.array(learned.source)
        own = np.flatnonzero(learned.is_image)
        partner[partner[own]] = own
        labels = [*parts, len(parts)] if tells_outside else parts
        tensors = (torch.as_tensor(values) for values in (partner, labels, images))
        return cls(*tensors, signs=torch.as_tensor(signs.round(), dtype=torch.float32))

    def to(self, device: torch.device) -> Mirror:
        return Mirror(*(tensor.to(device) for tensor in vars(self).values()))

    def images(self, points: Tensor, rows: Tensor) -> Tensor:
        """Points (B, N, 3) in canonical axes, or axes in which the object is as often its own image, of which the
        clouds ``rows`` (B,) are seen in the mirror."""
        return torch.where(rows[:, None, None], points * points.new_tensor(MIRROR_X), points)

    def back(self, said: Prediction, rows: Tensor) -> Prediction:
        """What is said of ``images``, said of what they are images of."""
        flip = said.keypoints.new_tensor(MIRROR_X)
        told = {
            "quaternion": said.quaternion * said.quaternion.new_tensor([1.0, 1.0, -1.0, -1.0]),
            "translation": said.translation * flip,
            "states": self.signs * said.states[:, self.joints],
            "keypoints": said.keypoints[:, self.keypoints] * flip,
            "log_sigma": said.log_sigma[:, self.keypoints],
            "part_logits": said.part_logits[..., self.labels],
        }
        among = {name: rows.view(-1, *[1] * (values.ndim - 1)) for name, values in told.items()}
        return replace(said, **{n: torch.where(among[n], values, getattr(said, n)) for n, values in told.items()})
