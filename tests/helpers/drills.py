"""Commands that are killed at any moment and run again: what must come out, and what must not be left behind."""

import hashlib
import json
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omad.model.checkpoint import WEIGHTS

from .command_line import K, laptop_view, save_png
from .own_models import write_microwaves
from .warm import Command

SPEC = str(Path(__file__).parents[2] / "docs" / "categories" / "microwave.toml")
LAPTOP = ["--category", "laptop"]
TRAINED = [*LAPTOP, "--objects", "2", "--batch", "2", "--seed", "1", "--threads", "1", "--device", "cpu",
           "--save-seconds", "0.01", "--output", "out"]  # fmt: skip
TIMED = ("seconds", "time", "version")
"""Fields that tell when, or how fast."""


@dataclass(frozen=True)
class Drill:
    """A command that writes into ``out``."""

    name: str
    arguments: list[str]
    same: bool = True
    """Whether another run writes the same bytes; if not, only the same files."""
    begun: tuple[str, ...] = ()
    """Files of ``checkpoint`` that lie in ``out`` already."""
    small: tuple[tuple[str, str, int], ...] = ()
    """Constants (module, name, value) that are smaller, so that it is done soon."""


DRILLS = [
    Drill("generate", ["generate", *LAPTOP, "--objects", "2", "--output", "out"]),
    Drill("render", ["render", *LAPTOP, "--objects", "2", "--views", "6", "--output", "out"]),
    Drill(
        "render artimage",
        ["render", *LAPTOP, "--objects", "2", "--views", "4", "--layout", "artimage", "--output", "out"],
    ),
    Drill("import", ["import", "models", "--category", SPEC, "--output", "out"]),
    Drill("train prior", ["train", "prior", "--steps", "15", *TRAINED]),
    Drill("train net", ["train", "net", "--steps", "10", *TRAINED]),
    Drill(
        "train surface",
        [
            *["train", "surface", *LAPTOP, "--weights", "out", "--objects", "4", "--views", "2"],
            *["--threads", "1", "--device", "cpu"],
        ],
        begun=("config.json", "model.safetensors"),
    ),
    Drill(
        "train confidence",
        ["train", "confidence", *LAPTOP, "--weights", "out", "--objects", "4", "--views", "14"],
        begun=("config.json", "model.safetensors"),
        small=tuple(("omad.evaluation.confidence.fitting", *each) for each in (("FEWEST", 4), ("STEPS", 10))),
    ),
    Drill(
        "index",
        ["index", "build", *LAPTOP, "--source", "procedural", "--objects", "2", "--output", "out/i.npz"],
        same=False,
    ),
    Drill("bulk", ["bulk", "frames", *LAPTOP, *K, "--workers", "1", "--batch", "2", "--output", "out/r.jsonl"]),
    Drill("track", ["track", "frames", *LAPTOP, *K, "--output", "out"]),
    Drill("export", ["export", *LAPTOP, "--output", "out"]),
]


def prepare() -> None:
    """Into the folder at hand, what the commands read."""
    write_microwaves(Path("models"), 2)
    for index in range(6):
        save_png(f"frames/frame_{index:02d}.png", laptop_view().depth)


def lay_out(drill: Drill) -> None:
    """What has to lie in ``out`` before the command is run."""
    Path("out").mkdir(exist_ok=True)
    for name in drill.begun:
        if not Path("out", name).exists():
            shutil.copy(WEIGHTS / "laptop" / name, Path("out", name))


def begin(drill: Drill, largest: int | None = None) -> Command:
    """The command in a process of its own, whose files may have ``largest`` bytes at most."""
    lay_out(drill)
    return Command(drill.arguments, largest, drill.small)


def kill_and_finish(drill: Drill, kills: int, seed: int) -> list[str]:
    """What is wrong after so many kills at any moment, and a run that is left alone."""
    began = time.monotonic()
    begin(drill).end()
    lasts, whole = time.monotonic() - began, written(Path("out"))
    Path("out").rename("whole")
    rng, wrong = np.random.default_rng(seed), list[str]()
    for share in rng.uniform(0.1, 1.0, kills):
        process = begin(drill)
        time.sleep(float(share) * lasts)
        process.kill()
        process.end()
    code, err = begin(drill).end()
    done = "is there already" in err  # the kill came when all was done, and what is done is not done again
    if (code and not done) or "Traceback" in err:
        wrong.append(f"exit code {code}: {err[-300:]}")
    found = written(Path("out"))
    if found.keys() != whole.keys():
        wrong.append(f"other files: {sorted(found.keys() ^ whole.keys())}")
    elif drill.same and (other := [name for name in whole if found[name] != whole[name]]):
        wrong.append(f"other content: {other}")
    wrong += [f"left behind: {path}" for path in Path().rglob(".omad-*") if path.is_file()]
    return wrong


def written(folder: Path) -> dict[str, str]:
    """Digests of all files; of JSON without what tells times. State, logs and pictures of matplotlib only by name."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or "tfevents" in path.name:
            continue
        content = path.read_bytes()
        if path.suffix in (".json", ".jsonl"):
            lines = content.decode().splitlines() if path.suffix == ".jsonl" else [content.decode()]
            content = json.dumps([_timeless(json.loads(line)) for line in lines]).encode()
        if path.name in ("metrics.jsonl", "state.pt", "import.json") or (
            path.suffix == ".png" and "models" in path.name
        ):
            content = b""
        found[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()
    return found


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(inner) for key, inner in value.items() if not any(word in key for word in TIMED)}
    return [_timeless(inner) for inner in value] if isinstance(value, list) else value
