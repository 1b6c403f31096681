"""``omad``: parse the command line, run the command, print for a person or for a program."""

from __future__ import annotations

import io
import json
import math
import os
import sys
from typing import Annotated, Any

# two threads that spin while they wait starve each other where cores are shared; must be set before torch loads
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "0")

import tyro

from . import commands as c
from . import commands_estimate as s
from . import commands_eval as e
from . import commands_explore as x
from . import commands_figures as f
from . import commands_import as i
from . import commands_retrieval as r
from . import commands_tables as b
from . import commands_track as k
from . import commands_train as t
from .errors import InputError, WorkError
from .tables import readable

_ABOUT = (
    "Shape, pose, joint states and joint axes of unseen articulated objects from one depth view."
    " Exit codes: 0 done, 1 the work itself failed, 2 bad input or usage."
)
_name = tyro.conf.subcommand
_Train = Annotated[
    Annotated[t.TrainPrior, _name("prior")]
    | Annotated[t.TrainNet, _name("net")]
    | Annotated[t.TrainAncsh, _name("ancsh")]
    | Annotated[t.TrainSiamese, _name("siamese")],
    _name("train", description="Train a category: first its prior, then its network; or the baselines."),
]
_Eval = Annotated[
    Annotated[e.EvalPose, _name("pose")]
    | Annotated[e.EvalKeypoints, _name("keypoints")]
    | Annotated[e.EvalViews, _name("views")]
    | Annotated[b.EvalTable1, _name("table1")]
    | Annotated[b.EvalTable2, _name("table2")]
    | Annotated[b.EvalAblation, _name("ablation")]
    | Annotated[r.EvalRetrieval, _name("retrieval")],
    _name("eval", description="Measure accuracy on objects with known truth."),
]
_Figure = Annotated[
    Annotated[f.FigureQualitative, _name("qualitative")]
    | Annotated[f.FigureKeypoints, _name("keypoints")]
    | Annotated[f.FigureSweep, _name("sweep")]
    | Annotated[f.FigureOcclusion, _name("occlusion")]
    | Annotated[f.FigureTsne, _name("tsne")],
    _name("figure", description="Draw figures from weights: results, keypoints, sweeps, occlusion, t-SNE."),
]
_Index = Annotated[
    Annotated[r.IndexBuild, _name("build")] | Annotated[r.IndexQuery, _name("query")],
    _name("index", description="Which object is this: a catalogue of objects that is asked with a view."),
]
_Command = (
    Annotated[c.Demo, _name("demo")]
    | Annotated[s.Estimate, _name("estimate")]
    | Annotated[k.Track, _name("track")]
    | Annotated[x.Explore, _name("explore")]
    | Annotated[c.Generate, _name("generate")]
    | Annotated[i.Import, _name("import")]
    | Annotated[c.Render, _name("render")]
    | _Train
    | _Eval
    | _Figure
    | _Index
    | Annotated[c.Export, _name("export")]
    | Annotated[c.Info, _name("info")]
)


def main() -> None:
    """Entry point. Exit codes: 0 done, 1 the work itself failed, 2 bad input or usage."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without a degree sign is no reason to fail
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has seen enough (`omad info | head -1`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code)


def parse(arguments: list[str]) -> Any:
    """The command that a command line means; raises SystemExit where it means none, or asks for help."""
    return tyro.cli(_Command, args=arguments, prog="omad", description=_ABOUT)  # type: ignore[call-overload]


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    command = parse(arguments)
    try:
        code, answer = command.run()
    except InputError as error:
        print(f"omad: {_line(error)}", file=sys.stderr)
        return 2
    except WorkError as error:
        print(f"omad: {_line(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("omad: interrupted; a rendering or training goes on where it was when run again", file=sys.stderr)
        return 130
    print(json.dumps(_known(answer)) if command.json else readable(answer))
    return code


def _line(error: Exception) -> str:
    """Messages are one line, whatever a file's name or another program put into them."""
    return " ".join(str(error).split())


def _known(value: Any) -> Any:
    """JSON has neither NaN nor infinity: what is unknown is null."""
    if isinstance(value, dict):
        return {key: _known(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_known(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
