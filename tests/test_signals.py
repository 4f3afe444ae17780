"""Signals: child processes end, and the best motion found so far is written."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import textwrap
import threading
import time
from select import select

import pytest
from unit.parallel_work import wait_for_stop_request

import tominpmp as tm
from tominpmp.initial_guess import parallel
from tominpmp.initial_guess.parallel import run_parallel

WAIT = 300.0  # for the processes of a busy machine [s]


def start(code, *arguments, **streams):
    """Run code in another process, in which Ctrl-C raises KeyboardInterrupt."""
    usual = "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    return subprocess.Popen(
        [sys.executable, "-c", usual + textwrap.dedent(code), *arguments],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams,
        text=True,
    )


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="looks into /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_child_processes_end_with_their_parent(number):
    code = """
        import os, sys, time
        sys.path.insert(0, sys.argv[1])
        from parallel_work import print_pid_and_sleep
        from tominpmp.initial_guess.parallel import run_parallel
        for _ in run_parallel(print_pid_and_sleep, [300.0, 300.0], 2):
            pass
    """
    folder = os.path.join(os.path.dirname(__file__), "unit")
    process = start(code, folder)
    pids = {int(process.stdout.readline()) for _ in range(2)}
    assert all(alive(pid) for pid in pids)
    process.send_signal(number)
    # The output ends when no process holds the pipe any more.
    process.communicate(timeout=WAIT)
    end = time.monotonic() + WAIT
    while any(alive(pid) for pid in pids) and time.monotonic() < end:
        time.sleep(0.1)
    assert not any(alive(pid) for pid in pids)


class InterruptOfTwoProcesses:
    """Presses Ctrl-C once two processes have begun their work."""

    def __init__(self, folder):
        self.folder = folder

    def __call__(self):
        while len(list(self.folder.iterdir())) < 2:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)


def test_interrupt_returns_the_results_of_child_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(parallel, "GRACE", WAIT)
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    found = []
    watch = threading.Thread(target=InterruptOfTwoProcesses(tmp_path), daemon=True)
    try:
        with pytest.raises(KeyboardInterrupt):
            watch.start()
            for result in run_parallel(wait_for_stop_request, [tmp_path, tmp_path], 2):
                found.append(result)
    finally:
        signal.signal(signal.SIGINT, former)
    assert sorted(found) == [(0, True), (1, True)]


COMMAND = """
    import os, signal, sys
    import tominpmp.cli.problem
    from tominpmp.cli import main
    from tominpmp.cli import plan
    from tominpmp.cli.plan import Progress
    number, count, where = int(sys.argv[1]), [0], sys.argv[2]
    usual = Progress.__call__

    def call(self, record):
        usual(self, record)
        count[0] += record.violation <= 1e-6 or count[0] > 0
        if where in ("planning", "closing") and count[0] == 3:
            from tominpmp.planner import plan_state
            plan_state.SAVING = 300.0  # a slow machine has time for the replay, too
            if where == "closing":
                os.write(1, b"ready")
                sys.stdin.read()
            os.kill(os.getpid(), number)

    def loading(*arguments):
        os.kill(os.getpid(), number)

    write = plan.write_files

    def writing(*arguments):
        os.kill(os.getpid(), number)
        return write(*arguments)

    Progress.__call__ = call
    if where == "loading":
        tominpmp.cli.problem.load_problem = loading
    if where == "writing":
        plan.write_files = writing
    sys.argv[1:] = sys.argv[3:]
    main()
"""
PLAN = "plan planar3r --start 0.5 1.7 -1.7 --goal 2 -1 0.5 -o motion.csv".split()
PLAN += ["--planning-effort", "quick"]


@pytest.mark.parametrize(
    ("number", "where"),
    [
        (signal.SIGINT, "loading"),
        (signal.SIGINT, "planning"),
        (signal.SIGTERM, "planning"),
        (signal.SIGHUP, "planning"),
        (signal.SIGTERM, "writing"),
        (signal.SIGTERM, "loading"),
        (signal.SIGINT, "writing"),
    ],
)
def test_interrupted_command_writes_its_motion(tmp_path, number, where):
    arguments = [str(int(number)), where, *PLAN]
    process = start(COMMAND, *arguments, cwd=tmp_path)
    out, errors = process.communicate(timeout=WAIT)
    assert process.returncode == 128 + number, errors
    if where == "loading":
        assert "interrupted" in errors and not os.listdir(tmp_path)
        return
    assert "duration" in out
    rows = (tmp_path / "motion.csv").read_text().splitlines()
    # By then, the only motion may be that of a coarse grid.
    assert len(rows) > 16 and len(rows[-1].split(",")) == len(rows[-2].split(","))
    assert os.listdir(tmp_path) == ["motion.csv"]


def test_command_writes_its_motion_when_the_terminal_is_closed(tmp_path):
    """The line of progress on a closed terminal cannot be cleared."""
    terminal, other = pty.openpty()
    arguments = [str(int(signal.SIGHUP)), "closing", *PLAN]
    process = start(COMMAND, *arguments, cwd=tmp_path, stdin=-1, stderr=other)
    while process.stdout not in (
        ready := select([process.stdout, terminal], [], [])[0]
    ):
        os.read(ready[0], 4096)
    os.close(other)
    os.close(terminal)
    out, _ = process.communicate("closed", timeout=WAIT)
    assert process.returncode == 128 + signal.SIGHUP
    assert "duration" in out
    assert os.listdir(tmp_path) == ["motion.csv"]


# The code with which the command and ``python -m tominpmp`` begin.
ENTRIES = {
    "command": "from tominpmp.cli import main; main()",
    "module": "import runpy; runpy.run_module('tominpmp', run_name='__main__')",
}
# Modules in the order of their import: the parser of the command line, the options, and
# modules whose import takes long.
STAGES = ("cyclopts", "tominpmp.cli.options", "numpy", "pinocchio", "tominpmp.goals")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("entry", ENTRIES)
def test_signals_during_imports_end_the_command_without_traceback(
    tmp_path, monkeypatch, entry, number
):
    """Each signal comes during the import of another module, which Python reports."""
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")
    for stage in STAGES:
        process = start(ENTRIES[entry], *PLAN, cwd=tmp_path)
        for line in process.stderr:
            if line.rpartition("|")[2].strip().startswith(stage):
                break
        process.send_signal(number)
        _, errors = process.communicate(timeout=WAIT)
        messages = [
            row for row in errors.splitlines() if not row.startswith("import time")
        ]
        assert messages == ["error: interrupted"], stage
        assert process.returncode == 128 + number, stage
        assert not os.listdir(tmp_path)


def test_signal_handlers_precede_all_other_imports():
    """Except modules that Python itself imports without a search for packages (-S)."""
    root = os.path.dirname(os.path.dirname(tm.__file__))
    code = f"import sys; sys.path.insert(0, {root!r}); import tominpmp.cli\n"
    code += (
        "print(sorted({'logging', 'typing', 'cyclopts', 'numpy'} & set(sys.modules)))"
    )
    command = [sys.executable, "-S", "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"


def test_log_records_are_not_written_by_default():
    """Standard error stays empty unless an application configures logging."""
    code = "from tominpmp.collision import decomposition_cache as those\n"
    code += "those.logger.warning('seen')"
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert found.stderr == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_a_batch_with_its_current_plan(tmp_path, number):
    robot = tm.load_robot("planar3r")
    for k in range(3):
        goal = tm.JointGoal((1.5 + 0.1 * k, -1.0, 0.5))
        problem = tm.Problem(robot, (0.5, 1.7, -1.7), goal)
        tm.save_scenario(tmp_path / f"{k}.toml", problem)
    words = f"batch {tmp_path} --workers 1 --planning-effort quick".split()
    process = start(ENTRIES["command"], *words, cwd=tmp_path)
    assert process.stderr.readline().startswith("1/3")
    process.send_signal(number)
    _, errors = process.communicate(timeout=WAIT)
    assert process.returncode == 128 + number, errors
    assert "interrupted" in errors and "3/3" not in errors
