"""Plans in several processes that end early.

They return the best motion found so far, and leave no process behind.
"""

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

WAIT = 300.0  # for the processes of a busy machine [s]

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

    reported, (signals, written) = [], os.pipe()
    os.set_blocking(written, False)
    signal.set_wakeup_fd(written)

    def report_children(record, after=lambda: os.read(signals, 1)):
        if record.violation <= 1e-6 and not reported:
            from tominpmp.planner import plan_state
            plan_state.SAVING = 300.0  # a slow machine has time for the replay, too
            reported.append(record)
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
        limit, endless = float(sys.argv[1]), sys.argv[1] == "inf"
        if not endless:  # a clock that stands still until the time is used up
            now = [1e5]
            time.perf_counter = lambda: now[0]
            used_up = lambda: now.append(now.pop() + limit)
            report_last = lambda record: report_children(record, used_up)
        solution = tm.plan(problem, processes=2, starts=40,
                           callback=report_children if endless else report_last,
                           intervals=20,  # too few for a coarse search first
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
            report_children(record)

        Progress.__call__ = call
        main()
"""
ARGUMENTS = (
    "plan planar3r --start 0.5 1.7 -1.7 --goal-position tip 4 1 0 --processes 2 "
    "--obstacle sphere:O:r=0.8:at=4,0,0 --starts 40 --intervals 20 "
    "--max-planning-time inf -o motion.csv"
).split()


def start_script(code: str, *arguments: str, cwd: Path) -> subprocess.Popen[str]:
    script = cwd / "script.py"
    script.write_text(textwrap.dedent(BEGIN) + textwrap.dedent(code))
    return subprocess.Popen(
        [sys.executable, str(script), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
    )


def await_child_processes(process: subprocess.Popen[str]) -> list[int]:
    """Ids of the child processes, which the script prints at its first motion."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith("["):
            pids = json.loads(line)
            assert len(pids) >= 2 and all(isinstance(pid, int) for pid in pids)
            return list(pids)
    raise AssertionError("the script ended before it had found a motion")


def rest_of_output(process: subprocess.Popen[str]) -> tuple[str, str]:
    """The rest of its output and errors, which end when no process holds the pipes."""
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


def test_interrupted_plan_returns_its_motion(tmp_path: Path) -> None:
    process = start_script(PLAN, "inf", cwd=tmp_path)
    pids = await_child_processes(process)
    process.send_signal(signal.SIGINT)
    out, errors = rest_of_output(process)
    assert process.returncode == 0, errors
    status, success, T = json.loads(out.splitlines()[-1])
    assert status == "INTERRUPTED" and success and 0.0 < T < 10.0
    assert all_end(pids)


def test_plan_returns_its_motion_at_the_time_limit(tmp_path: Path) -> None:
    process = start_script(PLAN, "300", cwd=tmp_path)
    pids = await_child_processes(process)
    out, errors = rest_of_output(process)
    assert process.returncode == 0, errors
    status, success, T = json.loads(out.splitlines()[-1])
    assert status == "TIME_LIMIT" and success and 0.0 < T < 10.0
    assert all_end(pids)


def test_child_processes_end_with_a_terminated_plan(tmp_path: Path) -> None:
    process = start_script(PLAN, "inf", cwd=tmp_path)
    pids = await_child_processes(process)
    process.terminate()
    rest_of_output(process)
    assert process.returncode == -signal.SIGTERM
    assert all_end(pids)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_interrupted_command_writes_its_motion(
    tmp_path: Path, number: signal.Signals
) -> None:
    process = start_script(COMMAND, *ARGUMENTS, cwd=tmp_path)
    pids = await_child_processes(process)
    process.send_signal(number)
    _, errors = rest_of_output(process)
    assert process.returncode == 128 + number, errors
    rows = (tmp_path / "motion.csv").read_text().splitlines()
    assert len(rows) > 20
    assert sorted(os.listdir(tmp_path)) == ["motion.csv", "script.py"]
    assert all_end(pids)
