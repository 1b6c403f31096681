"""A folder that is an estimator: graphs, numbers, and a program that needs NumPy and ONNX Runtime alone."""

import copy
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.files import make_folder, write_json, write_text
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.estimation.looks import relief, shown, turned
from omad.model import network_input
from omad.model.fitting.energy import ShapePrior
from omad.model.fitting.refinement import Refiner
from omad.model.fronts import image
from omad.model.fronts.hands import shipped_hand_net
from omad.model.omadnet import OmadNet
from omad.sensing import point_choice
from omad.sensing.observation import MIN_POINTS

from . import choice, given
from .graphs import energy_graph, hand_graph, network_graph

NUMBERS, PROGRAM, NEEDS = "estimator.json", "estimate.py", "requirements.txt"
NETWORK, ENERGY, HAND = "network.onnx", "energy.onnx", "hand.onnx"
BESIDE = {"choice": choice, "given": given, "relief": relief, "front_image": image}
"""Files that the program takes with it."""


def deploy(estimator: Estimator, folder: Path) -> list[str]:
    """Write the program that answers as the ``estimator`` does, in place of another in the folder; returns the names of
    its files. Raises InputError where ONNX's exporter is not installed, and for an estimator that leaves out the
    keypoints' confidence, or does not refine by least squares."""
    if not estimator.config.confidence or estimator.refine is not Refiner.__call__:
        raise InputError("estimator: leaves out confidence, or least squares; the program has both")
    make_folder(folder)
    net, hands = copy.deepcopy(estimator.net).cpu().eval(), shipped_hand_net()
    told, graphs = numbers(net, estimator.config, estimator.hand), {NETWORK: network_graph(net)}
    graphs[ENERGY] = energy_graph(net.prior)  # whose numbers are doubles from here on
    if estimator.hand and net.category.name in hands.names:
        graphs[HAND] = hand_graph(hands, net.category.name)
    else:
        (folder / HAND).unlink(missing_ok=True)  # of another deployment: the program takes what is there
    # all of it is made before anything is written, as graphs of one and numbers of another would answer wrongly
    for name, graph in graphs.items():
        graph.save(folder / name)
    write_json(folder / NUMBERS, told, indent=1)
    # not imported, as that takes ONNX Runtime
    source = Path(__file__).with_name("program.py").read_text(encoding="utf-8")
    for name, module in BESIDE.items():
        source = source.replace(f"from {module.__name__} import", f"from {name} import")
        write_text(folder / f"{name}.py", Path(str(module.__file__)).read_text(encoding="utf-8"))
    write_text(folder / PROGRAM, source)
    write_text(folder / NEEDS, "numpy>=1.26\nonnxruntime>=1.20\n")
    return [*graphs, NUMBERS, PROGRAM, *(f"{name}.py" for name in BESIDE), NEEDS]


def numbers(net: OmadNet, config: EstimatorConfig, hand: Sequence[float]) -> dict[str, Any]:
    """What the program knows besides the graphs."""
    category, fit, prior = net.category, config.refinement, net.prior
    shape = ShapePrior.of(prior.beta_mean, prior.beta_covariance, fit.prior_weight)
    return {
        "category": category.name,
        "joints": [joint.name for joint in category.joints],
        "turning": list(category.turning),
        "either_hand": category.either_hand,
        "hand": list(hand),
        "part_of_keypoint": list(category.part_of_keypoint),
        "metres_per_unit": category.metres_per_unit,
        "state_units": np.asarray(category.state_units).tolist(),
        "limits": category.limits.tolist(),
        "points": net.backbone.config.points,
        "tells_outside": net.tells_outside,
        "own_states": net.own_states,
        "samples": list(config.samples),
        "seed": config.seed,
        "cells": point_choice.CELLS_SEEN,
        "far": network_input.FAR,
        "least_points": MIN_POINTS,
        "sure": shown.SURE,
        "few": shown.FEW,
        "left": shown.LEFT,
        "unsure": turned.UNSURE,
        "surer": [turned.SURER, turned.SURER_INVERTED],
        "beta_mean": shape.mean.double().tolist(),
        "whitening": shape.whitening.tolist(),
        "huber": fit.huber,
        "limit_sigma": fit.limit_sigma,
        "trust_region": asdict(fit.trust_region),
        "termination": asdict(fit.termination),
    }
