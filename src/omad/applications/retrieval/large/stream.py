"""What comes in on its way into a catalogue: a few hundred at a time, never all of it."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from omad.estimation.estimator import Estimator
from omad.model.priornet import PriorNet
from omad.objects.model import ObjectModel

from .. import catalogue
from .parts import Portion

TOGETHER = 128
"""Inputs that are worked on together."""
T = TypeVar("T")


def portions_of_models(net: PriorNet, models: Sequence[ObjectModel], source: str) -> Iterator[Portion]:
    """One entry a model."""
    for start in range(0, len(models), TOGETHER):
        some = models[start : start + TOGETHER]
        found = catalogue.from_models(net, some, source)
        yield Portion.of(found.signatures, found.entries, len(some), net.prior.basis_size)


def portions_of_inputs(
    estimator: Estimator,
    inputs: Iterable[T],
    name_of: Callable[[T], str],
    seen: Callable[[list[T]], Iterable[catalogue.Seen]],
    fused: bool,
    doubtful: list[dict[str, Any]],
) -> Iterator[Portion]:
    """An entry an input, or with ``fused`` one for all inputs of one name that come one after the other. ``seen`` makes
    observations of inputs, of those that can be used. Entries that are doubtful are added to ``doubtful``, too."""
    for some in _whole_objects(inputs, name_of):
        found = catalogue.from_observations(estimator, seen(some), fused)
        doubtful += found.doubtful
        yield Portion.of(found.signatures, found.entries, len(some), estimator.net.prior.basis_size)


def _whole_objects(inputs: Iterable[T], name_of: Callable[[T], str]) -> Iterator[list[T]]:
    """Lists of some hundred, none of which ends between two inputs of one name."""
    some: list[T] = []
    for one in inputs:
        if len(some) >= TOGETHER and name_of(one) != name_of(some[-1]):
            yield some
            some = []
        some.append(one)
    if some:
        yield some
