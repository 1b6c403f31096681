"""Thousands of spoilt files through every reader: no traceback, no crash, none over 20 s or 2 GB.

python benchmarks/fuzz.py --inputs 10000 --seed 1
"""

import argparse
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.fuzzing import Target, attempt, targets

SECONDS, BYTES, CHUNK = 20, 2_000_000_000, 40


def read_chunk(target: Target, seed: tuple[int, ...], count: int) -> list[str]:
    """What goes wrong with so many inputs, in a process of their own."""
    folder = Path(tempfile.mkdtemp(prefix="omad-fuzz-"))
    said = folder / "said.txt"
    if (child := os.fork()) == 0:
        with said.open("w", buffering=1) as file:
            rng = np.random.default_rng(seed)
            for number in range(count):
                place = folder / str(number)
                place.mkdir()
                signal.alarm(SECONDS)
                before = os.dup(2)
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries' own warnings
                failure = attempt(target, rng, place)
                os.dup2(before, 2)
                os.close(before)
                signal.alarm(0)
                if failure:
                    file.write(" ".join(failure.split()) + "\n")
                shutil.rmtree(place)
            if (used := 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) > BYTES:
                file.write(f"{target.name}: {used / 1e9:.1f} GB\n")
        os._exit(0)
    _, status = os.waitpid(child, 0)
    failures = said.read_text(errors="replace").splitlines() if said.exists() else []
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        failures.append(f"{target.name}: " + ("no end" if number == signal.SIGALRM else f"ended by signal {number}"))
    shutil.rmtree(folder)
    return failures


def main() -> int:
    """0 where nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="readers with this in their name")
    options = parser.parse_args()
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        chosen = [target for target in targets(Path(folder)) if options.only in target.name]
        each = -(-options.inputs // len(chosen))
        for index, target in enumerate(chosen):
            for chunk, start in enumerate(range(0, each, CHUNK)):
                found.update(read_chunk(target, (options.seed, index, chunk), min(CHUNK, each - start)))
            print(f"{target.name}: {each} inputs, {found.total()} failures so far", file=sys.stderr, flush=True)
    for failure, count in found.most_common():
        print(f"{count}\t{failure}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
