"""Objects that a training does not see, and how well they are answered: while it goes on, to watch it, and at its end,
to say how far to trust what keypoints say of joint states."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Protocol, TypeVar

import torch
from torch import Generator, Tensor

from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewBatch, ViewSettings, draw_views
from omad.geometry.transforms import transform_points
from omad.model.fitting.leaning import leaning
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Refined, State, Targets
from omad.model.network_input import first_frame, to_input_frame
from omad.model.omadnet import OmadNet
from omad.objects.category import Category
from omad.objects.model import SampledObject

ONE_IN, MOST = 20, 16
"""Objects that are held back, and how many at most."""
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of the network's own joint states in an answer."""
FARTHEST = 5.0
"""Of a joint state's error, in medians of the fit's own: wild answers count as such, not by how wild they are."""
SURE = 2.0
"""Standard errors by which a share's gain must differ from none."""


class Named(Protocol):
    """An object, as far as it is asked."""

    @property
    def name(self) -> str: ...


M = TypeVar("M", bound=Named)


def split(models: Sequence[M]) -> tuple[list[M], list[M]]:
    """Objects to train on, and some that are held back; few objects are all trained on. Names decide, as if drawn: of
    more objects none is held back that fewer of them were trained on. Variants of a model are objects of their own,
    so that what is held back may be much like what is seen."""
    count = min(len(models) // ONE_IN, MOST)
    order = sorted(range(len(models)), key=lambda index: sha256(models[index].name.encode()).digest())
    held = {*order[:count]}
    seen = [model for index, model in enumerate(models) if index not in held]
    return seen, [models[index] for index in sorted(held)]


@dataclass(frozen=True)
class HeldBackAnswers:
    """To B views, camera frame and category units."""

    own: State
    """Of the network's last look."""
    refined: Refined
    targets: Targets


@dataclass(frozen=True)
class HeldBack:
    """Views of objects that a training does not see."""

    views: ViewBatch

    @classmethod
    def of(
        cls, models: Sequence[SampledObject], category: Category, settings: ViewSettings, device: torch.device | str
    ) -> "HeldBack":
        """64 views, without clutter."""
        bank = SurfaceBank.from_models(models, category, seed=1).to(device)
        return cls(draw_views(bank, category, 64, replace(settings, clutter=None), Generator(device).manual_seed(1)))

    @torch.no_grad()
    def answers(self, net: OmadNet) -> HeldBackAnswers:
        """By two looks, as the estimator has them."""
        limits = torch.as_tensor(net.category.limits).to(self.views.states)
        refiner, frame, start = Refiner(net.prior, limits), first_frame(self.views.points), None
        for _ in range(2):
            said = net(to_input_frame(self.views.points, frame), labels=False)
            targets = Targets(transform_points(frame, said.keypoints), (-2 * said.log_sigma).exp())
            own = State(said.beta, said.states, frame @ said.T_input_base)
            refined = refiner(targets, start or refiner.with_fitted_pose(targets, own))
            start, frame = refined.state, refined.state.T_camera_base
        return HeldBackAnswers(own, refined, targets)

    def errors(self, net: OmadNet) -> dict[str, float]:
        """Median errors of joint states, the network's own and refined, by what they are measured in."""
        answers, found = self.answers(net), {}
        said = {"own": answers.own.joint_states, "refined": answers.refined.state.joint_states}
        for unit, joints, factor in (("degrees", net.prior.turning, 180 / torch.pi), ("units", ~net.prior.turning, 1)):
            for name, states in said.items() if joints.any() else ():
                error = (states - self.views.states).abs()[:, joints].median()
                found[f"held back, {name} ({unit})"] = float(error) * factor
        return found

    def best_share(self, net: OmadNet) -> float:
        """The share of the network's own joint states that surely leaves the smallest error, summed over joints; that
        of the fit alone, 0, unless another is."""
        answers = self.answers(net)

        def errors(share: float) -> Tensor:
            return (_states(answers, net, share) - self.views.states).abs()

        unit = errors(0.0).median(0).values.clamp(min=1e-6)

        def gain(share: float) -> float:
            of_views = ((errors(0.0) / unit).clamp(max=FARTHEST) - (errors(share) / unit).clamp(max=FARTHEST)).sum(1)
            return float(of_views.mean() - SURE * of_views.std() / len(of_views) ** 0.5)

        return max(SHARES, key=gain)


def _states(answers: HeldBackAnswers, net: OmadNet, share: float) -> Tensor:
    return leaning(answers.refined, answers.own.joint_states, share, net.prior, answers.targets).state.joint_states
