"""Commands that write are killed at random moments, by SIGKILL: what they end with must be what an unkilled run ends
with, and nothing else may be left behind.

python benchmarks/tools/kill_drill.py --kills 100 --seed 1
"""

import argparse
import contextlib
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from helpers.drills import DRILLS, kill_and_finish, prepare


def main() -> int:
    """0 where nothing was lost and nothing left."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100, help="of all commands together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="commands with this in their name")
    options = parser.parse_args()
    drills = [drill for drill in DRILLS if options.only in drill.name]
    each, failed = -(-options.kills // len(drills)), 0
    for drill in drills:
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            prepare()
            wrong = kill_and_finish(drill, each, options.seed)
        failed += len(wrong)
        print(f"{drill.name}: {each} kills, {'; '.join(wrong) or 'nothing lost, nothing left'}", flush=True)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
