"""Plans in several processes that end early: what was found is kept, nobody stays."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks into /proc"),
]

WAIT = 300.0  # for processes of a machine that does other things, too [s]

# Processes ignore Ctrl-C where a shell has started them in the background.
BEGIN = """
    import json, os, signal, sys, time
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def children():
        found = []
        for entry in filter(str.isdigit, os.listdir("/proc")):
            try:
                with open(f"/proc/{entry}/stat") as file:
                    parent = file.read().rpartition(")")[2].split()[1]
            except OSError:
                continue
            if int(parent) == os.getpid():
                found.append(int(entry))
        return found

    told, (signals, written) = [], os.pipe()
    os.set_blocking(written, False)
    signal.set_wakeup_fd(written)

    def tell(record, after=lambda: os.read(signals, 1)):
        if record.violation <= 1e-6 and not told:
            from tominpmp.planner import plan_state
            plan_state.SAVING = 300.0  # a slow machine has time for the replay, too
            told.append(record)
            print(json.dumps(children()), flush=True)
            after()  # a signal has come, and was handled
"""
PLAN = """
    if __name__ == "__main__":
        import tominpmp as tm
        robot = tm.load_robot("planar3r")
        ball = tm.Sphere("ball", radius=0.8, position=(4.0, 0.0, 0.0))
        goal = tm.PositionGoal("tip", (4.0, 1.0, 0.0))
        problem = tm.Problem(robot, (0.5, 1.7, -1.7), goal, scene=tm.Scene([ball]))
        limit = float(sys.argv[1]) or None
        if limit is not None:  # a clock that stands still until the time is used up
            now = [1e5]
            time.perf_counter = lambda: now[0]
            used_up = lambda: now.append(now.pop() + limit)
            told_of = lambda record: tell(record, used_up)
        solution = tm.plan(problem, processes=2, starts=40,
                           callback=tell if limit is None else told_of,
                           intervals=20,  # whose starts are not judged first
                           max_planning_time=limit, tolerance=1e-9)
        print(json.dumps([solution.status.name, bool(solution), solution.T]))
"""
COMMAND = """
    if __name__ == "__main__":
        from tominpmp.cli import main
        from tominpmp.cli.plan import Progress
        usual = Progress.__call__

        def call(self, record):
            usual(self, record)
            tell(record)

        Progress.__call__ = call
        main()
"""
ASKED = (
    "plan planar3r --start 0.5 1.7 -1.7 --goal-position tip 4 1 0 --processes 2 "
    "--obstacle sphere:O:r=0.8:at=4,0,0 --starts 40 --intervals 20 -o motion.csv"
).split()


def begin(code: str, *arguments: str, cwd: Path) -> subprocess.Popen[str]:
    script = cwd / "script.py"
    script.write_text(textwrap.dedent(BEGIN) + textwrap.dedent(code))
    return subprocess.Popen(
        [sys.executable, str(script), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
    )


def processes_of(process: subprocess.Popen[str]) -> list[int]:
    """What the process says once it has found a motion: those it has started."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("["):
            pids = json.loads(line)
            assert len(pids) >= 2 and all(isinstance(pid, int) for pid in pids)
            return list(pids)
    raise AssertionError("it ended before it had found anything")


def ended(process: subprocess.Popen[str]) -> tuple[str, str]:
    """What is left of its output and errors, which end when nobody holds them."""
    assert process.stdout is not None and process.stderr is not None
    watch = threading.Timer(WAIT, process.kill)
    watch.start()
    out, errors = process.stdout.read(), process.stderr.read()
    process.wait()
    watch.cancel()
    process.stdout.close()
    process.stderr.close()
    return out, errors


def alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def all_end(pids: list[int]) -> bool:
    end = time.monotonic() + WAIT
    while any(map(alive, pids)) and time.monotonic() < end:
        time.sleep(0.1)
    return not any(map(alive, pids))


def test_an_interrupt_returns_the_motion(tmp_path: Path) -> None:
    process = begin(PLAN, "0", cwd=tmp_path)
    pids = processes_of(process)
    process.send_signal(signal.SIGINT)
    out, errors = ended(process)
    assert process.returncode == 0, errors
    status, success, T = json.loads(out.splitlines()[-1])
    assert status == "INTERRUPTED" and success and 0.0 < T < 10.0
    assert all_end(pids)


def test_the_end_of_the_time_returns_the_motion(tmp_path: Path) -> None:
    process = begin(PLAN, "300", cwd=tmp_path)
    pids = processes_of(process)
    out, errors = ended(process)
    assert process.returncode == 0, errors
    status, success, T = json.loads(out.splitlines()[-1])
    assert status == "TIME_LIMIT" and success and 0.0 < T < 10.0
    assert all_end(pids)


def test_nobody_stays_where_the_process_is_terminated(tmp_path: Path) -> None:
    process = begin(PLAN, "0", cwd=tmp_path)
    pids = processes_of(process)
    process.terminate()
    ended(process)
    assert process.returncode == -signal.SIGTERM
    assert all_end(pids)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_command_writes_the_motion(tmp_path: Path, number: signal.Signals) -> None:
    process = begin(COMMAND, *ASKED, cwd=tmp_path)
    pids = processes_of(process)
    process.send_signal(number)
    _, errors = ended(process)
    assert process.returncode == 128 + number, errors
    rows = (tmp_path / "motion.csv").read_text().splitlines()
    assert len(rows) > 20
    assert sorted(os.listdir(tmp_path)) == ["motion.csv", "script.py"]
    assert all_end(pids)
