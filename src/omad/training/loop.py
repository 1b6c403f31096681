"""The training loop that all networks share: seeded, resumable, limited by steps or by minutes."""

import copy
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Generator, Tensor, nn
from tqdm import tqdm

from omad.common.errors import InputError, WorkError
from omad.common.files import make_folder, write_atomic
from omad.data.surface_bank import SurfaceBank
from omad.model.checkpoint import Network
from omad.objects.category import Category
from omad.objects.model import SampledObject


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to train."""

    steps: int
    """Steps in all."""
    batch: int
    """Samples a step."""
    learning_rate: float = 2e-3
    """Peak; warmed up over the first 2 %, then a cosine down to zero."""
    weight_decay: float = 1e-4
    max_minutes: float | None = None
    """Finish within this time, learning rate and all, if ``steps`` would take longer."""
    seed: int = 0
    average: float = 0.999
    """Decay of the running average of the weights, which is what is kept in the end."""
    save_seconds: float = 60.0
    """How often the state is written, so that a killed training goes on from there."""
    log_steps: int = 20


@dataclass(frozen=True)
class Training:
    """Settings of a training; each network's adds its own."""

    schedule: Schedule


Terms = dict[str, Tensor]
"""Weighted terms of a loss, by name."""
N = TypeVar("N", bound=Network)
M = TypeVar("M", bound=nn.Module)


def seeded_bank(
    models: Sequence[SampledObject], category: Category, seed: int, device: torch.device | str
) -> SurfaceBank:
    """What every training begins with: the surfaces of ``models``, and the seed of the layers' initial weights set."""
    torch.manual_seed(seed)
    return SurfaceBank.from_models(models, category, seed=seed).to(device)


def train_network(
    net: N,
    loss_terms: Callable[[N, Generator], Terms],
    settings: Training,
    models: Sequence[SampledObject],
    folder: Path,
) -> N:
    """``train``, with the network, the ``settings`` and the names of the ``models`` as what is trained."""
    config = {"kind": net.kind, "category": asdict(net.category), "settings": asdict(settings)}
    return train(net, loss_terms, settings.schedule, folder, config | {"objects": [model.name for model in models]})


def train(
    model: M, loss_terms: Callable[[M, Generator], Terms], schedule: Schedule, folder: Path, config: dict[str, Any]
) -> M:
    """Train ``model`` in place and return its averaged twin.

    ``loss_terms`` draws a batch with the generator and returns the weighted terms of the loss; their sum is minimised.

    ``folder`` receives ``state.pt`` (everything needed to go on, replaced atomically), ``metrics.jsonl`` and
    TensorBoard events. ``config`` says what is trained; a state of another config is refused (InputError).
    """
    make_folder(folder)
    device = next(model.parameters()).device
    generator = Generator(device=device).manual_seed(schedule.seed)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=schedule.learning_rate, weight_decay=schedule.weight_decay)
    averaged = copy.deepcopy(model).requires_grad_(False)
    learned = {"model": model, "averaged": averaged, "optimizer": optimizer}
    step, seconds = 0, 0.0

    state_path = folder / "state.pt"
    identity = json.dumps({**config, "schedule": asdict(schedule)}, sort_keys=True, default=str)
    if state_path.exists():
        state = _read_state(state_path, identity)
        for name, part in learned.items():
            part.load_state_dict(state[name])
        generator.set_state(state["generator"].cpu())
        step, seconds = state["step"], state["seconds"]

    def save() -> None:
        state = {name: part.state_dict() for name, part in learned.items()}
        state |= {"identity": identity, "generator": generator.get_state(), "step": step, "seconds": seconds}
        write_atomic(state_path, lambda path: torch.save(state, path))

    log = MetricLog(folder, step)
    saved = time.monotonic()
    began = saved - seconds
    bar = tqdm(total=schedule.steps, initial=step, unit="step", file=sys.stderr, disable=not sys.stderr.isatty())
    try:
        while (progress := _progress(step, seconds, schedule)) < 1:
            for group in optimizer.param_groups:
                group["lr"] = schedule.learning_rate * _rate(progress)
            terms = loss_terms(model, generator)
            loss = torch.stack(list(terms.values())).sum()
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            nn.utils.clip_grad_norm_(trained, 10.0)
            optimizer.step()
            step += 1
            _average(averaged, model, min(schedule.average, (1 + step) / (10 + step)))
            now = time.monotonic()
            seconds = now - began
            bar.update()
            if step % schedule.log_steps == 0:
                values = {name: term.item() for name, term in terms.items()}
                if not math.isfinite(sum(values.values())):
                    raise WorkError(f"the loss is not finite at step {step} ({values}); lower the learning rate")
                log.write(step, seconds, schedule.batch, values, show=bar.disable)
            if now - saved > schedule.save_seconds:
                save()
                saved = now
    finally:
        bar.close()
        log.close()
    save()
    return averaged


class MetricLog:
    """Metrics as JSON lines, TensorBoard events (where it is installed), and plain lines now and then."""

    def __init__(self, folder: Path, first_step: int) -> None:
        path = folder / "metrics.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        # a resumed run repeats the steps after its last saved state
        path.write_text("".join(f"{line}\n" for line in lines if _step_of(line) <= first_step))
        self.file = path.open("a", buffering=1)
        self.shown = -math.inf
        try:
            from torch.utils.tensorboard import SummaryWriter

            self.board = SummaryWriter(str(folder), purge_step=first_step)
        except ImportError:
            print("tensorboard is not installed: metrics go to metrics.jsonl only", file=sys.stderr)
            self.board = None

    def write(self, step: int, seconds: float, batch: int, values: dict[str, float], show: bool) -> None:
        row = {"step": step, "seconds": round(seconds, 2), "loss": sum(values.values()), **values}
        self.file.write(json.dumps(row) + "\n")
        if self.board:
            for name, value in row.items():
                self.board.add_scalar(name, value, step)
        if show and seconds - self.shown > 30:
            self.shown = seconds
            rate = step * batch / max(seconds, 1e-9)
            terms = " ".join(f"{name} {value:.4f}" for name, value in values.items())
            print(f"step {step}  {seconds:.0f} s  {rate:.0f} samples/s  {terms}", file=sys.stderr, flush=True)

    def close(self) -> None:
        self.file.close()
        if self.board:
            self.board.close()


def _step_of(line: str) -> float:
    try:
        return json.loads(line)["step"]
    except (json.JSONDecodeError, KeyError):  # the last line of a killed run may be cut short
        return math.inf


def _read_state(path: Path, identity: str) -> dict[str, Any]:
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        same = state["identity"] == identity
    except Exception as error:
        raise InputError(f"{path}: not a training state of this program; choose another --output") from error
    if not same:
        raise InputError(f"{path}: belongs to a training with other settings; choose another --output or the same")
    return state


def _progress(step: int, seconds: float, schedule: Schedule) -> float:
    by_time = seconds / (60 * schedule.max_minutes) if schedule.max_minutes else 0.0
    return max(step / schedule.steps, by_time)


def _rate(progress: float) -> float:
    return min(1.0, (progress + 1e-3) / 0.02) * 0.5 * (1 + math.cos(math.pi * progress))


@torch.no_grad()
def _average(averaged: nn.Module, model: nn.Module, decay: float) -> None:
    for kept, new in zip(averaged.parameters(), model.parameters(), strict=True):
        kept.lerp_(new, 1 - decay)
    for kept, new in zip(averaged.buffers(), model.buffers(), strict=True):
        kept.copy_(new)
