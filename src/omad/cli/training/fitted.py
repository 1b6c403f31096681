"""What is fitted to a trained network: its surfaces, and how far to believe its answers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import omad
from omad.common.errors import InputError
from omad.common.files import unfinished, writing
from omad.common.lazy import lazy_imports
from omad.common.stderr import tell

from ..answer import Answer, table
from ..options import (
    CategoryCommand,
    CategoryName,
    Device,
    Json,
    Seed,
    check_category,
    check_positive,
    shipped_prior,
    use_threads,
)

with lazy_imports():
    from omad.applications.retrieval.signature import prior_fingerprint
    from omad.common.incoming import address_of
    from omad.common.runtime import pick_device
    from omad.data.source import is_generated, load_models
    from omad.estimation.confidence import model as confidences
    from omad.estimation.confidence import signals
    from omad.evaluation.confidence import fitting
    from omad.evaluation.confidence.gathered import Begun
    from omad.evaluation.confidence.hands import fit_hand
    from omad.evaluation.confidence.shared import fit_shared
    from omad.evaluation.confidence.surface_shares import follows_better, measured_shares
    from omad.evaluation.paper.predictions import weights_identity
    from omad.model.checkpoint import find_weights, load
    from omad.model.omadnet import OmadNet
    from omad.model.priornet import PriorNet
    from omad.model.surfaces import bank as banks
    from omad.model.surfaces.surfaces import Surfaces
    from omad.objects.category import Category
    from omad.objects.model import digest_of_models
    from omad.training.train_surfaces import surface_bank

BEGUN = "confidence.begun"
"""The folder, among the weights, of what a training of confidence that goes on has done."""
UNSEEN = 1
"""Seed of procedural objects that are of the training split, but not those that networks are trained on."""
VIEWS_AN_OBJECT = 20
"""As many views as confidence is learned from for an object that is seen from several sides."""


@dataclass(frozen=True, kw_only=True)
class TrainSurface:
    """Make the bank of objects that estimates take their surfaces from: no training, a minute or two. To be made anew
    whenever the prior or the procedural generator changes. How far --to-surface should go, and whether surfaces
    should follow what is seen of an object beyond what those of the bank are, is measured, too, on views of objects
    that the network has not seen."""

    category: CategoryName
    weights: Path | None = None
    """OMADNet checkpoint folder that the bank is for, and is put into; default: the shipped one."""
    prior: Path | None = None
    """Checkpoint folder of its prior; default: prior/ in the weights' folder, or the shipped one."""
    source: str = "procedural"
    """procedural, or a generator of your own (.py) or a folder of models, which are kept with their meshes."""
    objects: int = 1000
    """Procedural objects."""
    unseen: str | None = None
    """Models to measure on, that the network has not seen; default: others by the generator, and nothing is measured
    where --source is a folder."""
    views: int = 120
    """Of these, every second one spoilt."""
    threads: int = 0
    """CPU threads; 0: PyTorch's choice."""
    device: Device = "auto"
    json: Json = False

    def run(self) -> Answer:
        check_positive(objects=self.objects, views=self.views)
        use_threads(self.threads)
        folder = find_weights(self.weights or self.category)
        own = folder / "prior"
        prior = self.prior or (own if own.is_dir() else shipped_prior(self.category))
        net = load(PriorNet, prior).to(pick_device(self.device))
        check_category("--prior", prior, net.category, self.category)
        estimator = _answering(folder, self.device)
        if prior_fingerprint(net.prior, net.category) != prior_fingerprint(estimator.net.prior, estimator.category):
            raise InputError(f"{prior}: is not the prior that {folder} was trained with; give that one with --prior")
        _check_folder_of(self.weights, folder, banks.FILE)
        models = load_models(self.source, net.category, self.objects, "train", 0).models
        bank = surface_bank(net, models, generated=self.source == "procedural")
        unseen = self.unseen or (self.source if is_generated(self.source) else None)
        record = dict.fromkeys(("shares", "errors", "views", "follows"))
        if unseen is not None:
            models = load_models(unseen, net.category, self.views, "train", UNSEEN).models
            estimator.answers.surfaces = Surfaces(estimator.net.prior, net.category, lambda: bank)
            shares = measured_shares(estimator, models, self.views, seed=0)
            if shares is not None:
                follows = follows_better(estimator, bank, models, self.views // 2, seed=0)
                bank = replace(bank, shares=shares, follows=follows)
                record |= {"shares": shares.taken.tolist(), "errors": shares.errors.tolist(), "views": shares.views}
                record["follows"] = follows
        path = bank.save(folder)  # the last: where it is, all that is measured is in it
        if estimator.answers.asked == signals.IMAGE:
            tell(f"{folder / confidences.FILE}: asks for the surfaces that were there; run omad train confidence anew")
        record = {"file": str(path), "objects": len(bank), "bytes": path.stat().st_size, **record}
        return Answer(record, partial(surface_text, net.category))


@dataclass(frozen=True, kw_only=True)
class TrainConfidence(CategoryCommand):
    """Learn how far to believe a network's answers: intervals of joint states, and the probability that an answer is
    right. From views of objects that the network has not seen, spoilt at random, and of other things; a few minutes.
    Where objects may be of either hand, how to tell which is learned first, from twice as many views and their mirror
    images. How alike views of one object err is learned last. Where a bank of surfaces lies beside the network, answers
    are also held against what was seen, if that tells enough. Writes confidence.json into the checkpoint folder, in
    place of what is there, and says how well it keeps its word on a quarter as many views of other scenes. A killed one
    goes on when the same command is given again."""

    source: str = "procedural"
    """procedural, a generator of your own (.py), or a folder of URDF / PartNet-Mobility models; best of such that the
    network was not trained on."""
    objects: int = 1000
    """Procedural objects."""
    views: int = 2000
    """To fit on."""
    seed: Seed = 0
    threads: int = 1
    """CPU threads; 0: PyTorch's choice."""

    def run(self) -> Answer:
        check_positive(objects=self.objects, views=self.views)
        fitting.check_views(self.views)
        use_threads(self.threads)
        folder = find_weights(self.weights or self.category)
        net = load(OmadNet, folder)
        self.check_weights(net.category)
        category = net.category
        surfaces = Surfaces.beside(folder, net.prior, category)
        # what it may know of its errors is of before
        estimator = omad.Estimator(net, device=pick_device(self.device), surfaces=surfaces)
        estimator.answers.asked = signals.IMAGE if surfaces else signals.WITHOUT_SURFACE
        models = load_models(self.source, category, self.objects, "train", UNSEEN).models
        _check_folder_of(self.weights, folder, confidences.FILE)
        made_of = {"weights": weights_identity(folder), "objects": digest_of_models(models)}
        made_of |= {"views": str(self.views), "seed": str(self.seed), "omad": omad.__version__}
        begun = Begun(folder / BEGUN, made_of)
        if category.either_hand:
            estimator.hand = fit_hand(estimator, models, 2 * self.views, self.seed + 1, begun)
        answers = fitting.answered(estimator, models, self.views, self.seed, begun)
        confidence = fitting.fit(answers, category, fitting.FittedTo(self.source, self.views, omad.__version__))
        confidence = replace(confidence, hand=estimator.hand)
        judging = omad.Estimator(net, device=estimator.device, confidence=confidence, surfaces=surfaces)
        shared = fit_shared(judging, models, max(self.views // VIEWS_AN_OBJECT, 1), self.seed + 3, begun)
        confidence = replace(confidence, shared=shared)
        # not those fitted to
        others = fitting.answered(estimator, models, max(self.views // 4, 1), self.seed + 2, begun)
        confidence.save(folder)
        begun.end()
        asks = {
            f"asks_{what}": name in confidence.image
            for what, name in (("front", "front"), ("surface", signals.IMAGE[-1]))
        }
        record = {"checkpoint": str(folder), "views": self.views, **asks}
        return Answer(record | fitting.measured(confidence, others, category), confidence_text)


def _answering(folder: Path, device: str) -> omad.Estimator:
    """With what the weights know of their errors, but where that asks for surfaces that are yet to be made, or is of
    other weights."""
    try:
        return omad.Estimator.from_pretrained(folder, device)
    except InputError:
        return omad.Estimator(load(OmadNet, folder), device=pick_device(device))


def _check_folder_of(weights: Path | None, folder: Path, file: str) -> None:
    """Before the work: raises InputError where a ``file`` cannot be put into the ``folder`` of weights; of shipped ones
    it says so."""
    if weights is not None and address_of(weights) is not None:
        raise InputError(f"--weights {weights}: is at an address, where nothing is written; give a folder of your own")
    with writing(folder / file), unfinished(folder / file):
        pass
    if weights is None:
        told = f"{folder / file}: of the shipped weights, is written anew"
        tell(f"{told}; to keep it, give --weights a copy, as omad export makes it")


NOT_MEASURED = (
    "how far --to-surface goes was not measured: few views were answered, or --source is a folder without --unseen"
)


def surface_text(category: Category, answer: dict[str, Any]) -> str:
    """A line for the base and each joint: degrees of what turns, category units of all else."""
    made = f"{answer['file']}: {answer['objects']} objects, {answer['bytes'] / 1000:.0f} kB"
    if answer["shares"] is None:
        return f"{made}\n{NOT_MEASURED}"
    rows = [["mean error", "of keypoints' answers", "of fits to the surface", "with --to-surface", "share of the way"]]
    names = ["base's ends", *(joint.name for joint in category.joints)]
    for row, name in enumerate(names):
        turns = row > 0 and category.turning[row - 1]
        errors = (of_all[row] for of_all in answer["errors"])
        told = [f"{math.degrees(error):.1f}°" if turns else f"{error:.3f} u" for error in errors]
        rows.append([name, *told, f"{answer['shares'][row]:.0%}"])
    follows = f"surfaces follow what is seen: {'yes' if answer['follows'] else 'no'}"
    return "\n".join([made, table(rows), f"on {answer['views']} views of unseen objects; {follows}"])


def confidence_text(answer: dict[str, Any]) -> str:
    """What it promises, and how it keeps that on views that it was not fitted to."""
    promised = {
        "joint states in their 50 % interval": ("covered_50", "50%"),
        "joint states in their 90 % interval": ("covered_90", "90%"),
        "base's rotation within one deviation": ("rotation_covered_68", "68%"),
        "base's translation within one deviation": ("translation_covered_68", "68%"),
    }
    rows = [["on other views", "promised", "measured"]]
    rows += [[name, share, f"{answer[key]:.0%}"] for name, (key, share) in promised.items()]
    error, area = answer["calibration_error"], answer["area_under_roc"]
    told = f"{answer['right']:.0%} of the answers are right; their probability: calibration error {error:.3f}"
    asked = {"what the front looks like": answer["asks_front"], "what the surface explains": answer["asks_surface"]}
    asks = "; ".join(f"asks {what}: {'yes' if does else 'no'}" for what, does in asked.items())
    made = f"{answer['checkpoint']}: confidence.json, fitted to {answer['views']} views"
    return "\n".join([made, table(rows), f"{told}, area under the ROC {area:.3f}", asks])
