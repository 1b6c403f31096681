"""Processes end as they are asked to, with one line, and nobody is left behind."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")

START_UP = """
import time
from omad.common.processes.signals import end_at_once
end_at_once()
print("ready", flush=True)
time.sleep(60)
"""
WORK = """
import time
from omad.common.processes.signals import raise_in_work
raise_in_work()
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt as error:
    print(type(error).__name__)
"""
HELPERS = """
import os, time
from omad.common.processes.workers import helpers

def begin(): ...

if __name__ == "__main__":
    pool = helpers(2, begin)
    both = set()
    while len(both) < 2:  # one that has yet to begin does not know better
        both.add(pool.submit(os.getpid).result())
    print(*both, flush=True)
    time.sleep(60)
"""


def started(code: str) -> tuple[subprocess.Popen, str]:
    """A process that has said its first line."""
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    return process, process.stdout.readline()


@pytest.mark.parametrize(
    ("number", "code", "said"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "term")]
)
def test_a_signal_at_start_up_is_one_line(number, code, said):
    process, _ = started(START_UP)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code
    assert err.startswith(f"omad: {said}")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(("number", "said"), [(signal.SIGINT, "KeyboardInterrupt"), (signal.SIGTERM, "Terminated")])
def test_a_signal_in_the_work_is_raised_there(number, said):
    process, _ = started(WORK)
    process.send_signal(number)
    out, _ = process.communicate(timeout=60)
    assert out.strip() == said


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc")
def test_helpers_end_with_the_process_that_was_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(HELPERS)
    process = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    pids = [int(pid) for pid in process.stdout.readline().split()]
    assert pids
    process.kill()
    process.communicate(timeout=60)
    end = time.monotonic() + 60
    while any(map(alive, pids)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(map(alive, pids))


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc")
def test_helpers_leave_ctrl_c_to_the_process_they_help(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(HELPERS)
    process = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert err.count("Traceback") == 1  # of the process itself, which here catches nothing
