"""The training loop that all networks share: seeded, resumable, limited by steps or by minutes."""

import copy
import io
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Generator, Tensor, nn
from tqdm import tqdm

from omad.common.arrays import digest_of
from omad.common.errors import InputError, WorkError
from omad.common.files import make_folder, write_atomic, write_text, writing
from omad.common.incoming import check_file, read_text, readable
from omad.common.processes.locks import only_one
from omad.common.processes.signals import deferred
from omad.common.stderr import is_watched
from omad.data.surface_bank import SurfaceBank
from omad.model.checkpoint import STATE, Network
from omad.objects.category import Category
from omad.objects.model import SampledObject

from .processes import ALONE, Processes

ANOTHER = "choose another --output, or give the same options and files as before"


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to train."""

    steps: int
    """Steps in all."""
    batch: int
    """Samples a step, of all processes together."""
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
CHECKS = 20
"""How often in a training held-back objects are looked at."""
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
    bank: SurfaceBank,
    made_of: Sequence[nn.Module | None] = (),
    check: Callable[[N], dict[str, float]] | None = None,
    processes: Processes = ALONE,
) -> N:
    """``train``, where what is trained is the network with all that it depends on: the ``settings``, the ``models`` and
    their surfaces in ``bank``, and the networks that it is ``made_of`` or begins with."""
    config = {"kind": net.kind, "category": asdict(net.category), "settings": asdict(settings)}
    config |= {"objects": [model.name for model in models], "surfaces": digest_of(vars(bank))}
    config["networks"] = [None if one is None else digest_of(one.state_dict()) for one in made_of]
    return train(net, loss_terms, settings.schedule, folder, config, check, processes)


def train(
    model: M,
    loss_terms: Callable[[M, Generator], Terms],
    schedule: Schedule,
    folder: Path,
    config: dict[str, Any],
    check: Callable[[M], dict[str, float]] | None = None,
    processes: Processes = ALONE,
) -> M:
    """Train ``model`` in place and return its averaged twin.

    ``loss_terms`` draws a batch with the generator, or of several ``processes`` the ``share`` of one, and returns the
    weighted terms of the loss; their sum is minimised. ``check`` says now and then how the averaged twin does on what
    is held back.

    ``folder`` receives ``state.pt`` (everything needed to go on, replaced atomically), ``metrics.jsonl`` and
    TensorBoard events. ``config`` says what is trained; a state of another config is refused (InputError), and so is a
    folder in which another process trains. Ctrl-C and SIGTERM end it after the step at hand, once the state is saved.
    Another number of processes may go on with it. WorkError where one of them ends.
    """
    if processes.first:
        make_folder(folder)
    with only_one(folder, "a training") if processes.first else nullcontext():
        return _train(model, loss_terms, schedule, folder, config, check, processes)


def _train(
    model: M,
    loss_terms: Callable[[M, Generator], Terms],
    schedule: Schedule,
    folder: Path,
    config: dict[str, Any],
    check: Callable[[M], dict[str, float]] | None,
    processes: Processes,
) -> M:
    device = next(model.parameters()).device
    generator = processes.generator(schedule.seed, device)
    processes.begin_alike(model)
    trained = [p for p in model.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(trained, lr=schedule.learning_rate, weight_decay=schedule.weight_decay)
    averaged = copy.deepcopy(model).requires_grad_(False)
    processes.shorten(model)
    learned = {"model": model, "averaged": averaged, "optimizer": optimizer}
    step, seconds = 0, 0.0

    state_path = folder / STATE
    identity = _identity(config, schedule)
    state = processes.from_first(lambda: _read_state(state_path, identity) if state_path.exists() else None)
    if state is not None:
        with readable(state_path, "a training state", ANOTHER):
            step, seconds, generator = _restore(state, learned, schedule.seed, device, processes)
        if processes.first:
            todo = "has ended before" if _progress(step, seconds, schedule) >= 1 else "goes on"
            print(f"{folder}: the training {todo}, after {step} steps", file=sys.stderr)

    def save() -> None:
        first, *others = processes.all_of(generator.get_state())
        if not processes.first:
            return
        state = {name: part.state_dict() for name, part in learned.items()}
        state |= {"identity": identity, "generator": first, "generators": others, "step": step, "seconds": seconds}
        state["dropout"] = _dropout_state(device)
        kept = io.BytesIO()  # a full disk is an OSError when bytes are written, and anything when torch writes
        torch.save(state, kept)
        write_atomic(state_path, lambda path: path.write_bytes(kept.getbuffer()))

    log = MetricLog(folder, step) if processes.first else None
    checked = int(CHECKS * _progress(step, seconds, schedule))
    saved = time.monotonic()
    began, asked = saved - seconds, 0.0
    quiet = not (processes.first and is_watched())
    bar = tqdm(total=schedule.steps, initial=step, unit="step", file=sys.stderr, disable=quiet)
    with closing(log) if log else nullcontext(), closing(bar), deferred() as stop:
        while (progress := _progress(step, seconds, schedule)) < 1 and not asked:
            for group in optimizer.param_groups:
                group["lr"] = schedule.learning_rate * _rate(progress)
            names, means = _descend(model, loss_terms, generator, optimizer, processes)
            step += 1
            _average(averaged, model, min(schedule.average, (1 + step) / (10 + step)))
            now = time.monotonic()
            # the first one's clock, and anyone's signal, are for all: they save and end after the same step
            own = (now - began, now - saved > schedule.save_seconds) if processes.first else (0.0, False)
            seconds, due, asked = processes.agree(*own, stop.number)
            bar.update()
            if step % schedule.log_steps == 0:
                values = dict(zip(names, processes.mean(means).tolist(), strict=True))
                if not math.isfinite(sum(values.values())):
                    raise WorkError(f"the loss is not finite at step {step} ({values}); lower the learning rate")
                progress = _progress(step, seconds, schedule)
                held_back = {}
                if log and check is not None and int(CHECKS * progress) > checked:
                    checked, held_back = int(CHECKS * progress), check(averaged)
                left = seconds * max(1 / progress - 1, 0)
                bar.set_postfix_str(" ".join([f"{left / 60:.1f} min left", *_plain(held_back)]))
                if log:
                    log.write(step, seconds, left, schedule.batch, values, held_back, show=bar.disable)
            if due or asked or _progress(step, seconds, schedule) >= 1:
                _check_finite(trained, step)
            if due:
                save()
                saved = now
        save()
        processes.take_leave()
        if asked:
            stop.number = int(asked)
    return averaged


def _restore(
    state: dict[str, Any], learned: dict[str, Any], seed: int, device: torch.device, processes: Processes
) -> tuple[int, float, Generator]:
    """Put a state into what it is of; its step, its seconds, and a generator that goes on as its own would have."""
    for name, part in learned.items():
        part.load_state_dict(state[name])
    step, seconds = int(state["step"]), float(state["seconds"])
    if "dropout" in state:  # a state of an earlier version has none
        _set_dropout_state(state["dropout"], device)
    generators = [state["generator"], *state.get("generators", [])]
    if processes.rank >= len(generators):
        return step, seconds, processes.generator(seed, device, step)
    generator = processes.generator(seed, device)
    generator.set_state(generators[processes.rank].cpu().clone())  # a part of another tensor would crash it
    return step, seconds, generator


def _descend(
    model: M,
    loss_terms: Callable[[M, Generator], Terms],
    generator: Generator,
    optimizer: torch.optim.Optimizer,
    processes: Processes,
) -> tuple[list[str], Tensor]:
    """One step of the optimiser; the terms' names, and their means (T,) over this process's parts of the batch."""
    optimizer.zero_grad(set_to_none=True)
    names, parts = [], []
    for _ in range(processes.parts):
        terms = loss_terms(model, generator)
        names, values = list(terms), torch.stack(list(terms.values()))
        (values.sum() / processes.parts).backward()
        parts.append(values.detach())
    trained = [p for group in optimizer.param_groups for p in group["params"]]
    processes.average([p.grad for p in trained if p.grad is not None])
    nn.utils.clip_grad_norm_(trained, 10.0)
    optimizer.step()
    return names, torch.stack(parts).mean(0)


def _check_finite(trained: Sequence[nn.Parameter], step: int) -> None:
    """Before a state is saved: from one with NaN no training could go on."""
    if not all(p.isfinite().all() for p in trained):
        raise WorkError(f"the weights are not finite at step {step}; lower the learning rate")


class MetricLog:
    """Metrics as JSON lines, TensorBoard events (where it is installed), and plain lines now and then."""

    def __init__(self, folder: Path, first_step: int) -> None:
        self.path = folder / "metrics.jsonl"
        lines = read_text(self.path, errors="replace").splitlines() if self.path.exists() else []
        # a resumed run repeats the steps after its last saved state
        write_text(self.path, "".join(f"{line}\n" for line in lines if _step_of(line) <= first_step))
        with writing(self.path):
            self.file = self.path.open("a", buffering=1)
        self.shown = -math.inf
        try:
            from torch.utils.tensorboard import SummaryWriter

            self.board = SummaryWriter(str(folder), purge_step=first_step)
        except ImportError:
            what = "metrics go to metrics.jsonl only, as tensorboard is not installed (pip install 'omad[train]')"
            print(what, file=sys.stderr)
            self.board = None

    def write(
        self,
        step: int,
        seconds: float,
        left: float,
        batch: int,
        values: dict[str, float],
        held_back: dict[str, float],
        show: bool,
    ) -> None:
        row = {"step": step, "seconds": round(seconds, 2), "loss": sum(values.values()), **values, **held_back}
        with writing(self.path):
            self.file.write(json.dumps(row) + "\n")
        if self.board:
            with suppress(OSError):  # a picture of what stands in metrics.jsonl
                for name, value in row.items():
                    self.board.add_scalar(name, value, step)
        if show and (held_back or seconds - self.shown > 30):
            self.shown = seconds
            rate, terms = step * batch / max(seconds, 1e-9), " ".join(_plain({**values, **held_back}))
            clock = f"{seconds:.0f} s, {left / 60:.1f} min left"
            print(f"step {step}  {clock}  {rate:.0f} samples/s  {terms}", file=sys.stderr, flush=True)

    def close(self) -> None:
        with suppress(OSError):
            self.file.close()
        if self.board:
            with suppress(OSError):
                self.board.close()


def _plain(values: dict[str, float]) -> list[str]:
    return [f"{name} {value:.4f}" for name, value in values.items()]


def _step_of(line: str) -> float:
    try:
        return float(json.loads(line)["step"])
    except (ValueError, KeyError, TypeError, RecursionError):  # the last line of a killed run may be cut short
        return math.inf


def _identity(config: dict[str, Any], schedule: Schedule) -> str:
    """What is trained; how often that is written down is no part of it."""
    usual = {"save_seconds": Schedule.save_seconds, "log_steps": Schedule.log_steps}

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: usual.get(key, plain(each)) for key, each in value.items()}
        return value

    return json.dumps(plain({**config, "schedule": asdict(schedule)}), sort_keys=True, default=str)


def _dropout_state(device: torch.device) -> Tensor:
    """Of the generator that dropout draws from."""
    return torch.cuda.get_rng_state(device) if device.type == "cuda" else torch.get_rng_state()


def _set_dropout_state(state: Tensor, device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.set_rng_state(state, device)
    else:
        torch.set_rng_state(state)


def _read_state(path: Path, identity: str) -> dict[str, Any]:
    with readable(path, "a training state of this program", ANOTHER):
        check_file(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
        found = state["identity"]
    if found != identity:
        raise InputError(f"{path}: belongs to a training with {_differences(found, identity)}; {ANOTHER}")
    return state


def _differences(found: str, wanted: str) -> str:
    """What two trainings do not share, by name."""
    with suppress(ValueError, AttributeError):
        return f"other {', '.join(sorted({*_unlike(json.loads(found), json.loads(wanted))}))}"
    return "other settings"


def _unlike(one: Any, other: Any, name: str = "settings") -> Iterator[str]:
    """Names of what differs, down to single settings, with their values where these are numbers."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {**one, **other}:
            yield from _unlike(one.get(key), other.get(key), key)
    elif one != other:
        numbers = all(isinstance(value, int | float | None) for value in (one, other))
        yield f"{name} ({one}, here {other})" if numbers else name


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
