"""Spoilt inputs by the thousand for every reader, command and function: no traceback, no crash, no 20 s, no 2 GB.

python benchmarks/tools/fuzz.py --inputs 10000 --seed 1

One that fails is tried again alone with --only NAME --first NUMBER --inputs 1 and the same seed.
"""

import argparse
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import zlib
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from helpers.fuzzing import Call, Command, Target, targets

SECONDS, BYTES = 20, 2_000_000_000
WAITING = 300
"""Seconds by the clock, of a machine that has other work to do: for what waits, and computes nothing."""


def try_some(target: Target | Command | Call, seed: int, first: int, last: int) -> list[str]:
    """What goes wrong with the inputs of these numbers, tried in a process of their own; after one that ends it, the
    next ones have another."""
    failures, number = list[str](), first
    folder = Path(tempfile.mkdtemp(prefix="omad-fuzz-"))
    said, at = folder / "said.txt", folder / "at.txt"
    said.touch()
    while number < last:
        at.write_text(str(number))
        if (child := os.fork()) == 0:
            try:
                _work(target, seed, range(number, last), folder)
            except BaseException:
                traceback.print_exc()
            os._exit(0)
        _, status = os.waitpid(child, 0)
        number = int(at.read_text()) + 1
        if os.WIFSIGNALED(status):
            which = os.WTERMSIG(status)
            ended = "no end" if which in (signal.SIGALRM, signal.SIGPROF) else f"ended by signal {which}"
            failures.append(f"{target.name} #{number - 1} {ended}")
    failures += said.read_text(errors="replace").splitlines()
    shutil.rmtree(folder)
    return failures


def _work(target: Target | Command | Call, seed: int, numbers: range, folder: Path) -> None:
    with (folder / "said.txt").open("a", buffering=1) as said:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries say themselves
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        for number in numbers:
            (folder / "at.txt").write_text(str(number))
            place = folder / f"{os.getpid()}-{number}"
            place.mkdir()
            signal.alarm(WAITING)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            rng = np.random.default_rng((seed, zlib.crc32(target.name.encode()), number))
            failure = target.attempt(rng, place)
            signal.alarm(0)
            signal.setitimer(signal.ITIMER_PROF, 0)
            if failure:
                said.write(f"{target.name} #{number} {' '.join(failure.split())}\n")
            shutil.rmtree(place, ignore_errors=True)
            if (used := 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) > BYTES:
                said.write(f"{target.name} #{number} {used / 1e9:.1f} GB\n")
                return  # the most that a process ever used stays with it


def main() -> int:
    """0 where nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="those with this in their name")
    parser.add_argument("--first", type=int, default=0, help="number of the first input of each")
    options = parser.parse_args()
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        chosen = [target for target in targets(Path(folder)) if options.only in target.name]
        each = -(-options.inputs // len(chosen))
        for target in chosen:
            found.update(failures := try_some(target, options.seed, options.first, options.first + each))
            print(f"{target.name}: {each} inputs, {len(failures)} failures", file=sys.stderr, flush=True)
            for failure in failures:
                print(f"  {failure}", file=sys.stderr, flush=True)
    print(f"{each * len(chosen)} inputs, {found.total()} failures")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
