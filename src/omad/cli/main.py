"""``omad``: parse the command line, run the command, print for a person or for a program."""

import io
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, Any, Union

# two threads that spin while they wait starve each other where cores are shared; must be set before torch loads
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "0")

import tyro

from omad import __version__
from omad.common.errors import InputError, WorkError, as_line, shown
from omad.common.files import NO_ROOM, one_line
from omad.common.processes.signals import end_at_once, exit_code, raise_in_work

from .answer import as_json
from .estimate import Detect, EstimateCommand
from .evaluation.correspondence import EvalKeypoints, EvalViews
from .evaluation.pose import EvalPose
from .evaluation.retrieval import EvalRetrieval
from .evaluation.robustness import EvalRobustness
from .evaluation.shape import EvalShape
from .explore import Explore
from .figures import FigureKeypoints, FigureOcclusion, FigureQualitative, FigureSweep, FigureTsne
from .index import IndexBuild, IndexMerge, IndexQuery
from .models import Generate, Import, Render
from .options import ALIASES, check_seed
from .paper import EvalAblation, EvalTable1, EvalTable2
from .scale.bulk import Bulk
from .scale.serve import Serve
from .shipped import Compile, Demo, Deploy, Export, Info
from .track import Track
from .training.all import TrainAll
from .training.fitted import TrainConfidence, TrainSurface
from .training.fronts import TrainFronts
from .training.networks import TrainAncsh, TrainNet, TrainPrior, TrainSiamese
from .training.proposals import TrainProposals

ABOUT = (
    "Shape, pose, joint states and joint axes of unseen articulated objects from one depth view."
    " Exit codes: 0 done, 1 the work itself failed (estimate --strict: the answer is doubtful),"
    " 2 bad input or usage. omad --version prints the version."
)


@dataclass(frozen=True)
class Group:
    """Commands of one name and another name each, as ``omad train net``."""

    about: str
    commands: dict[str, Any]


_TRAIN = {"prior": TrainPrior, "net": TrainNet, "confidence": TrainConfidence, "surface": TrainSurface}
_TRAIN |= {"all": TrainAll, "proposals": TrainProposals, "fronts": TrainFronts}
_TRAIN |= {"ancsh": TrainAncsh, "siamese": TrainSiamese}
_EVAL = {"pose": EvalPose, "keypoints": EvalKeypoints, "views": EvalViews, "table1": EvalTable1, "table2": EvalTable2}
_EVAL |= {"shape": EvalShape, "ablation": EvalAblation, "retrieval": EvalRetrieval, "robustness": EvalRobustness}
_FIGURE = {"qualitative": FigureQualitative, "keypoints": FigureKeypoints, "sweep": FigureSweep}
_FIGURE |= {"occlusion": FigureOcclusion, "tsne": FigureTsne}
_INDEX = {"build": IndexBuild, "merge": IndexMerge, "query": IndexQuery}
COMMANDS: dict[str, Any] = {"demo": Demo, "estimate": EstimateCommand, "detect": Detect, "bulk": Bulk}
COMMANDS |= {"track": Track, "explore": Explore, "serve": Serve}
COMMANDS |= {"generate": Generate, "import": Import, "render": Render}
COMMANDS["train"] = Group(
    "Train a category: its prior, then its network, then its confidence; or the baselines.", _TRAIN
)
COMMANDS["eval"] = Group("Measure accuracy on objects with known truth.", _EVAL)
COMMANDS["figure"] = Group("Draw figures from weights: results, keypoints, sweeps, occlusion, t-SNE.", _FIGURE)
COMMANDS["index"] = Group("Which object is this: a catalogue of objects that is asked with a view.", _INDEX)
COMMANDS |= {"export": Export, "deploy": Deploy, "info": Info, "compile": Compile}


def main() -> None:
    """Entry point. Exit codes: 0 done, 1 the work itself failed, 2 bad input or usage, 130 Ctrl-C, 143 SIGTERM."""
    raise_in_work()
    for name in ("stdout", "stderr"):  # closed by whoever began this
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (as long as the process)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without a degree sign is no reason to fail
    if os.name == "nt" and isinstance(sys.stdin, io.TextIOWrapper) and not sys.stdin.isatty():
        sys.stdin.reconfigure(encoding="utf-8", errors="surrogateescape")  # names of files, as other systems give them
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has seen enough (`omad info | head -1`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except KeyboardInterrupt:
        code = _interrupted()
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        print(f"omad: cannot be written ({error.strerror})", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    end_at_once()
    sys.exit(code)


def _flow_help() -> None:
    """Tyro breaks a help text where its docstring does, at indented lines and at those that begin with no letter."""
    vars(tyro._strings)["remove_single_line_breaks"] = lambda text: re.sub(r"(?<!\n)\n(?!\n)", " ", cleandoc(text))


with suppress(AttributeError):  # of another version
    _flow_help()


def parse(arguments: list[str]) -> Any:
    """The command that a command line means; raises SystemExit where it means none, or asks for help."""
    return tyro.cli(_one_of(COMMANDS), args=arguments, prog="omad", description=ABOUT)


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    if arguments == ["--version"]:
        print(__version__)
        return 0
    try:
        command = parse(arguments)
        check_options(command, arguments)
        answer = command.run()
    except (InputError, WorkError) as error:
        print(f"omad: {one_line(error)}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    except KeyboardInterrupt:
        return _interrupted()
    except MemoryError:
        print("omad: out of memory; give smaller input, or fewer at a time", file=sys.stderr)
        return 1
    except Exception:
        if exit_code():  # a library may turn an interruption into an error of its own
            return _interrupted()
        raise
    text = as_json(answer.record) if command.json else answer.text(answer.record)
    print("\n".join(map(as_line, text.splitlines())))
    return answer.code


def check_options(options: Any, arguments: Sequence[str] = ()) -> None:
    """Raises InputError for what no file can be called, for a seed that is none, and for an option among the
    ``arguments`` that is to name something and names nothing, as a shell's variable that is not set does, or that takes
    a list and is given twice."""
    for field in fields(options):
        value, option = getattr(options, field.name), f"--{field.name.replace('_', '-')}"
        names = (option, ALIASES.get(field.name))
        given = [argument for argument in arguments if argument.split("=")[0].replace("_", "-") in names]
        if given and value == field.default == ():
            raise InputError(f"{given[0]}: names nothing; name at least one, or leave it out")
        if len(given) > 1 and isinstance(value, tuple):
            raise InputError(f"{given[1]}: was given before, and only the last counts; put all behind one {option}")
        if field.name == "seed":
            check_seed(value)
        for path in value if isinstance(value, tuple) else (value,):
            if is_dataclass(path):
                check_options(path, arguments)
            elif isinstance(path, Path):
                try:
                    path.exists()
                    if "\0" in str(path):  # which is not there, for some versions of Python
                        raise ValueError("embedded null byte")
                except (OSError, ValueError) as error:
                    reason = error.strerror if isinstance(error, OSError) else error
                    raise InputError(f"{shown(path)}: cannot be the path of a file ({reason}); give another") from error


def _interrupted() -> int:
    resumed = "bulk, render, import, train (but surface), eval retrieval and catalogues on disk"
    print(f"omad: interrupted; given again, {resumed} go on where they were", file=sys.stderr)
    return exit_code() or 130


def _one_of(commands: dict[str, Any]) -> Any:
    """The type that tyro takes for a choice of these."""
    choices = []
    for name, command in commands.items():
        kind, about = (_one_of(command.commands), command.about) if isinstance(command, Group) else (command, None)
        choices.append(Annotated[kind, tyro.conf.subcommand(name, description=about)])
    return Union[tuple(choices)]  # noqa: UP007 (their number is not known here)
