"""Whatever was found is what an interrupt, a time limit or a failing stage returns."""

from __future__ import annotations

import signal
import time
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from sample_arms import DOWNWARD, make_arm, rod

import tominpmp as tm
from tominpmp import stopping
from tominpmp.linear_programs.choice import make_solver
from tominpmp.linear_programs.program import LinearProgram
from tominpmp.planner import coarse_search, descent, planning
from tominpmp.planner.candidate import Candidate
from tominpmp.solvers.quiet_torques import QuietTorques
from tominpmp.solvers.trust_region_step import TrustRegionStep
from tominpmp.stopping import Deadline, Stop

START, END = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)


@pytest.fixture(autouse=True)
def interruptible():
    """Ctrl-C raises, also where a shell has left it ignored, as in the background."""
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, former)


def press():
    signal.raise_signal(signal.SIGINT)  # heeded before it returns, two of them as two


def reach(**changes):
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, START, tm.JointGoal(END), **changes)


def pendulums():
    arm = make_arm(
        rod(1.0, 1.0), rod(1.0, 1.0), effort=np.array([40.0, 15.0]), gravity=DOWNWARD
    )
    return tm.Problem(arm, (-1.3, 0.3), tm.JointGoal((0.3, 0.8)))


class Interrupter:
    """Presses Ctrl-C a few records after the first one of a motion that will do."""

    def __init__(self, after, way=press):
        self.after, self.way = after, way
        self.found = self.seen = 0

    def __call__(self, record):
        self.seen += 1
        self.found += record.violation <= 1e-6 or self.found > 0
        return self.way() if self.found == self.after else None

    @property
    def over(self):
        return self.found >= self.after


@pytest.mark.parametrize("way", [press, lambda: True])
@pytest.mark.parametrize("after", [1, 3, 9, 40])
@pytest.mark.usefixtures("clock")
def test_exact_switching_interrupted_keeps_the_motion(monkeypatch, after, way):
    callback, steps = Interrupter(after, way), []
    usual = TrustRegionStep._propose

    def counted(self, *arguments):
        done = usual(self, *arguments)
        steps.append(callback.over)
        return done

    def spend(budget, evaluations):
        assert not callback.over, "it looks for exact switching still"

    monkeypatch.setattr(TrustRegionStep, "_propose", counted)
    monkeypatch.setattr(stopping.Budget, "spend", spend)
    options = tm.Options(refine="switching", callback=callback)
    solution = tm.plan(pendulums(), options)
    assert callback.over, "the test interrupts too late"
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok
    assert steps and not any(steps), "it goes on iterating"
    assert callback.found == after


@pytest.mark.usefixtures("clock")
def test_an_exception_of_the_callback_keeps_the_motion():
    def raising():
        raise KeyboardInterrupt

    solution = tm.plan(
        reach(), tm.Options(effort="quick", callback=Interrupter(2, raising))
    )
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(
    "error", [ValueError, ZeroDivisionError, RuntimeError, KeyError, tm.ProblemError]
)
@pytest.mark.parametrize("options", [{}, {"control_period": 0.01}])
def test_errors_of_the_callback_reach_the_caller(error, options):
    """Those that numerics raise as well were taken for failures of a start."""
    shown = []

    def callback(record):
        shown.append(record)
        if options and len(shown) < 12:
            return
        raise error("mine")

    with pytest.raises(error, match="mine"):
        tm.plan(reach(), effort="quick", callback=callback, **options)


def test_interrupted_before_there_is_anything(monkeypatch):
    def pressed(*arguments, **named):
        press()
        stopping.check()

    monkeypatch.setattr("tominpmp.planner.starts.guesses_of", pressed)
    solution = tm.plan(reach(), effort="quick")
    assert solution.status is tm.Status.INTERRUPTED
    assert not solution.success and solution.trajectory is None


def test_out_of_time_before_there_is_anything(monkeypatch):
    """The message said that the time had not settled, of a motion that never was."""

    def late(*arguments, **named):
        raise stopping.Stop(requested=False)

    monkeypatch.setattr("tominpmp.planner.starts.guesses_of", late)
    solution = tm.plan(reach(), effort="quick", max_planning_time=3.0)
    assert solution.status is tm.Status.TIME_LIMIT
    assert not solution.success and solution.trajectory is None
    assert "no motion was found. 3 s were allowed" in solution.message


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("stage", ["verify", "lower_bound"])
def test_interrupted_in_a_later_stage(monkeypatch, stage):
    place = {"verify": "planner.candidate", "lower_bound": "planner.plan_state"}[stage]
    module = f"tominpmp.{place}.{stage}"
    calls = []
    usual = tm.verify if stage == "verify" else tm.lower_bound

    def pressed(*arguments, **named):
        calls.append(1)
        if len(calls) == 1:
            press()
            stopping.check()
        return usual(*arguments, **named)

    monkeypatch.setattr(module, pressed)
    solution = tm.plan(reach(), effort="quick")
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok


@pytest.mark.usefixtures("clock")
def test_interrupted_at_the_very_end(monkeypatch):
    usual = planning.with_remarks

    def pressed(*arguments):
        done = usual(*arguments)
        press()
        return done

    monkeypatch.setattr(planning, "with_remarks", pressed)
    solution = tm.plan(reach(), effort="quick")
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok
    assert solution.message.startswith(tm.Status.INTERRUPTED.value)
    monkeypatch.setattr(planning, "why_impossible", lambda *_: "It cannot be.")
    solution = tm.plan(reach(), effort="quick")
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.message == "It cannot be."


@pytest.mark.usefixtures("clock")
def test_interrupted_while_torques_are_made_quiet(monkeypatch):
    usual = QuietTorques.model

    def pressed(self, *arguments):
        press()
        return usual(self, *arguments)

    monkeypatch.setattr(QuietTorques, "model", pressed)
    solution = tm.plan(reach(), tm.Options(effort="quick", slack=0.02))
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok
    assert "left as they are" in solution.message
    done = tm.plan(reach(), effort="quick")
    again = tm.smooth(done)
    assert again.status is tm.Status.INTERRUPTED and again.T == done.T


@pytest.mark.parametrize(
    "error", [np.linalg.LinAlgError("singular"), ZeroDivisionError(), ValueError("no")]
)
def test_a_later_stage_that_fails_keeps_the_motion(monkeypatch, error):
    def failing(*arguments):
        raise error

    monkeypatch.setattr(descent, "on_finer_grids", failing)
    solution = tm.plan(reach(), tm.Options(refine="grid"))
    assert solution.success and solution.verification.ok
    assert "later stage failed" in solution.message


def test_a_start_that_fails_leaves_it_to_the_others(monkeypatch):
    usual, calls = descent.descend, []

    def failing(*arguments, **named):
        calls.append(1)
        if len(calls) == 1:
            raise ZeroDivisionError
        return usual(*arguments, **named)

    few = tm.Options(intervals=24, effort="quick", refine=None, starts=2)
    monkeypatch.setattr(descent, "descend", failing)
    assert tm.plan(reach(), few).success
    monkeypatch.setattr(descent, "descend", lambda *a: 1 / 0)
    far = tm.Scene([tm.Sphere("far", radius=0.1, position=(9.0, 9.0, 0.0))])
    coarse = tm.plan(reach(scene=far), few)
    assert coarse.success and "ZeroDivisionError" in coarse.message
    monkeypatch.setattr(coarse_search, "descend", lambda *a, **k: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        tm.plan(reach(scene=far), few)


@pytest.mark.parametrize(("spent", "time_to_replay"), [(1.0, True), (1.2, False)])
def test_time_used_up_within_the_first_solve(clock, spent, time_to_replay):
    """A replay may take a little more than the limit, and no more than that."""
    limit = 500.0

    def slow(record):
        if record.violation <= 1e-6:
            clock.advance(spent * limit)

    options = tm.Options(
        effort="quick", max_planning_time=limit, tolerance=1e-9, callback=slow
    )
    solution = tm.plan(reach(), options)
    assert solution.status is tm.Status.TIME_LIMIT
    assert solution.iterations >= 1
    assert solution.success is time_to_replay
    if time_to_replay:
        assert solution.verification.ok
    else:
        assert "no time to verify" in solution.message


def test_motions_there_was_no_time_to_replay_are_not_said_to_be_refuted(monkeypatch):
    usual, replayed = Candidate.verified, []

    def first_refuted(self, *arguments, **named):
        replayed.append(self.trajectory.duration)
        if len(replayed) > 1:
            raise Stop(requested=False)
        attempt = usual(self, *arguments, **named)
        refuted = replace(attempt.verification, ok=False)
        return replace(attempt, verification=refuted)

    monkeypatch.setattr(Candidate, "verified", first_refuted)
    options = tm.Options(
        effort="quick", callback=lambda record: record.violation < 1e-6
    )
    solution = tm.plan(reach(), options)
    assert len(replayed) > 1 and not solution.success
    assert solution.status is tm.Status.INTERRUPTED
    assert "no time to verify" in solution.message


# -- native code -----------------------------------------------------------------------


def hard_program(size, rows, density):
    """A linear program that takes far longer than anyone waits."""
    rng = np.random.default_rng(0)
    matrix = sp.random(rows, size, density, random_state=1, format="csc")
    bound, ones = rng.uniform(1.0, 2.0, rows), np.ones(size)
    cost, keys = rng.normal(size=size), np.arange(max(rows, size))
    ends = -bound, bound, -ones, ones
    return LinearProgram(cost, matrix, *ends, keys[:rows], keys[:size])


# What the slowest machine is waited for [s]; the programs would take longer.
LONG = 60.0


@pytest.mark.parametrize("solver", ["highs", "piqp"])
def test_solvers_keep_a_deadline(solver):
    program = hard_program(1500, 2500, 0.02 if solver == "highs" else 0.003)
    deadline = Deadline()
    begin = time.perf_counter()
    deadline.end = begin + 0.3
    with deadline.in_force(), pytest.raises(Stop):
        for _ in range(100):
            make_solver(solver).solve(program)
    assert time.perf_counter() - begin < LONG


@pytest.fixture
def patient(monkeypatch):
    """No request is repeated because the machine is slow to heed the first."""
    monkeypatch.setattr(stopping, "PATIENCE", LONG)


@pytest.mark.usefixtures("patient")
def test_a_request_ends_a_run_of_highs():
    program, deadline = hard_program(1500, 2500, 0.02), Deadline()
    begin = time.perf_counter()
    former = signal.signal(signal.SIGALRM, lambda *_: press())
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    try:
        with deadline.in_force(), pytest.raises(Stop) as caught:
            make_solver("highs").solve(program)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)
    assert caught.value.requested
    assert time.perf_counter() - begin < LONG


def test_code_that_does_not_ask_is_interrupted_all_the_same(monkeypatch):
    monkeypatch.setattr(stopping, "PATIENCE", 0.2)
    deadline = Deadline()
    with pytest.raises(KeyboardInterrupt), deadline.in_force():
        press()
        end = time.perf_counter() + LONG
        while time.perf_counter() < end:
            time.sleep(0.01)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("patient")
def test_a_second_request_interrupts_at_once():
    deadline = Deadline()
    with pytest.raises(KeyboardInterrupt), deadline.in_force():
        press()
        press()
        pytest.fail("the second one was not heeded")


def test_processes_are_counted():
    with pytest.raises(tm.OptionsError, match="processes is 10000, expected"):
        tm.Options(processes=10**4)


def test_callbacks_see_every_record():
    seen = []
    solution = tm.plan(
        reach(),
        effort="quick",
        refine=None,
        callback=lambda record: seen.append(record.duration),
    )
    assert [record.duration for record in solution.history] == seen
