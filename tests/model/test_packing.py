"""Weights in eight bits, and in half precision."""

from pathlib import Path

import numpy as np
import pytest
import torch

from omad.model.checkpoint import WEIGHTS, load, save, write_tensors
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.model.storage.packing import halved, packed, unpacked


def test_what_is_unpacked_is_within_half_a_step_of_what_was_packed():
    torch.manual_seed(0)
    before = {"a": torch.randn(40, 30), "b": torch.randn(50, 4, 8) * 1e-3, "prior.c": torch.randn(60, 60)}
    before |= {"small": torch.randn(3, 3), "bias": torch.randn(2000), "count": torch.arange(3000).view(100, 30)}
    before["zero"] = torch.zeros(40, 40)
    kept = packed(before)
    assert kept["a"].dtype == kept["b"].dtype == torch.int8
    after = unpacked(kept)
    assert after.keys() == before.keys()
    for name, values in before.items():
        assert after[name].shape == values.shape
        if name in ("a", "b", "zero"):
            step = values.flatten(1).abs().amax(1) / 127
            off = (after[name] - values).flatten(1).abs().amax(1)
            assert (off <= 0.5001 * step + 1e-12).all()
        else:
            assert torch.equal(after[name], values)
    assert all(torch.equal(one, after[name]) for name, one in unpacked(after).items())


def test_what_is_halved_is_within_half_precision_but_for_what_stays_exact(tmp_path: Path):
    torch.manual_seed(0)
    before = {"a": torch.randn(40, 30), "prior.c": torch.randn(60, 60), "bias": torch.randn(2000)}
    kept = halved(before)
    assert [kept[name].dtype for name in before] == [torch.float16, torch.float32, torch.float32]
    torch.testing.assert_close(kept["a"].float(), before["a"], rtol=2**-11, atol=1e-7)
    for folder in (WEIGHTS / "laptop" / "prior", WEIGHTS / "drawer_5" / "prior"):
        net = load(PriorNet, folder)
        assert {values.dtype for values in net.state_dict().values() if values.is_floating_point()} == {torch.float32}
        write_tensors(halved(net.state_dict()), tmp_path)
        assert (tmp_path / "model.safetensors").read_bytes() == (folder / "model.safetensors").read_bytes()


def test_a_packed_checkpoint_answers_as_before(tmp_path: Path):
    source = WEIGHTS / "laptop"
    net = load(OmadNet, source)
    torch.manual_seed(0)
    with torch.no_grad():  # off the steps that these weights were packed to
        for values in net.parameters():
            values.mul_(1 + 0.002 * torch.randn_like(values))
    save(net, tmp_path / "whole", {})
    save(net, tmp_path / "small", {})
    write_tensors(packed(net.state_dict()), tmp_path / "small")
    whole, small = (tmp_path / name / "model.safetensors" for name in ("whole", "small"))
    assert small.stat().st_size < 0.3 * whole.stat().st_size
    cloud = torch.from_numpy(np.random.default_rng(0).normal(size=(2, 1024, 3)).astype(np.float32) * 0.3)
    with torch.no_grad():
        one, other = (load(OmadNet, path.parent)(cloud) for path in (whole, small))
    spread = one.keypoints.flatten(1).std().item()
    assert (one.keypoints - other.keypoints).abs().mean().item() == pytest.approx(0, abs=0.02 * spread)
