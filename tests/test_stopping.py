"""After an interrupt, a time limit or a failing stage, a plan returns its motion."""

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
from tominpmp.planner.plan_state import PlanState
from tominpmp.solvers.quiet_torques import QuietTorques
from tominpmp.solvers.trust_region_step import TrustRegionStep
from tominpmp.stopping import Deadline, Stop

START, END = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)


@pytest.fixture(autouse=True)
def interruptible():
    """Ctrl-C raises, also where a shell ignores it for processes in the background."""
    former = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, former)


def press():
    signal.raise_signal(
        signal.SIGINT
    )  # handled before the call returns, so that two signals count as two


def reach(**changes):
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, START, tm.JointGoal(END), **changes)


def pendulums():
    arm = make_arm(
        rod(1.0, 1.0), rod(1.0, 1.0), effort=np.array([40.0, 15.0]), gravity=DOWNWARD
    )
    return tm.Problem(arm, (-1.3, 0.3), tm.JointGoal((0.3, 0.8)))


class Interrupter:
    """Presses Ctrl-C a few records after the first record of a feasible motion."""

    def __init__(self, after, way=press):
        self.after, self.way = after, way
        self.feasible = self.seen = 0

    def __call__(self, record):
        self.seen += 1
        self.feasible += record.violation <= 1e-6 or self.feasible > 0
        return self.way() if self.feasible == self.after else None

    @property
    def has_interrupted(self):
        return self.feasible >= self.after


@pytest.mark.parametrize("way", [press, lambda: True])
@pytest.mark.parametrize("after", [1, 3, 9, 40])
@pytest.mark.usefixtures("clock")
def test_interrupted_exact_switching_keeps_the_motion(monkeypatch, after, way):
    callback, steps = Interrupter(after, way), []
    usual = TrustRegionStep._propose

    def counted(self, *arguments):
        done = usual(self, *arguments)
        steps.append(callback.has_interrupted)
        return done

    def spend(budget, evaluations):
        assert not callback.has_interrupted, (
            "the search for exact switching continues after the interrupt"
        )

    monkeypatch.setattr(TrustRegionStep, "_propose", counted)
    monkeypatch.setattr(stopping.Budget, "spend", spend)
    options = tm.Options(refine="switching", callback=callback)
    solution = tm.plan(pendulums(), options)
    assert callback.has_interrupted, "the test interrupts too late"
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok
    assert steps and not any(steps), "the descent continues after the interrupt"
    assert callback.feasible == after


@pytest.mark.usefixtures("clock")
def test_keyboard_interrupt_in_the_callback_keeps_the_motion():
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
    """Regression: types that numerical code raises, too, counted as failed starts."""
    records = []

    def callback(record):
        records.append(record)
        if options and len(records) < 12:
            return
        raise error("mine")

    with pytest.raises(error, match="mine"):
        tm.plan(reach(), effort="quick", callback=callback, **options)


def test_interrupt_before_the_first_guess_returns_no_motion(monkeypatch):
    def pressed(*arguments, **named):
        press()
        stopping.check()

    monkeypatch.setattr("tominpmp.planner.starts.guesses_of", pressed)
    solution = tm.plan(reach(), effort="quick")
    assert solution.status is tm.Status.INTERRUPTED
    assert not solution.success and solution.trajectory is None


def test_time_limit_before_the_first_guess_returns_no_motion(monkeypatch):
    """Regression: the message said that T had not settled, without a motion."""

    def late(*arguments, **named):
        raise stopping.Stop(requested=False)

    monkeypatch.setattr("tominpmp.planner.starts.guesses_of", late)
    solution = tm.plan(reach(), effort="quick", max_planning_time=3.0)
    assert solution.status is tm.Status.TIME_LIMIT
    assert not solution.success and solution.trajectory is None
    assert "no motion was found. 3 s were allowed" in solution.message


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("stage", ["verify", "lower_bound"])
def test_interrupted_verification_or_bound_loses_no_motion(monkeypatch, stage):
    """The bound is found before any motion; a replay follows the first one."""
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
    if solution.iterations:
        assert solution.success and solution.verification.ok
    assert (solution.iterations > 0) == (stage == "verify")


def test_interrupted_replay_after_the_time_limit_loses_no_motion(monkeypatch):
    """Regression: Ctrl-C during the only replay of the last motion lost this motion."""

    def limit(state):
        return 0.0 if any(item.feasible for item in state.kept_iterates) else np.inf

    def pressed(*arguments, **named):
        if not pressed.calls:
            pressed.calls += 1
            press()
            stopping.check()
        return tm.verify(*arguments, **named)

    pressed.calls = 0
    monkeypatch.setattr("tominpmp.planner.candidate.verify", pressed)
    monkeypatch.setattr(PlanState, "_candidate_end", limit)
    solution = tm.plan(reach(), effort="quick")
    assert solution.status is tm.Status.INTERRUPTED
    assert solution.success and solution.verification.ok


def test_bounds_of_distances_look_at_the_clock():
    """Regression: a second passed between two looks, among many pairs of bodies."""
    ball = tm.Sphere("ball", radius=0.1, position=(30.0, 0.0, 0.0))
    checker = reach(scene=[ball]).checker
    checker.distances(np.array([START]), 0.1)  # the bounding volumes are made
    deadline = Deadline()
    deadline.end = 0.0
    with deadline.in_force(), pytest.raises(Stop):
        checker.distances(np.array([START]), 0.1)


@pytest.mark.usefixtures("clock")
def test_interrupt_at_the_end_keeps_motion_and_reason(monkeypatch):
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
def test_interrupted_smoothing_keeps_the_motion(monkeypatch):
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
def test_failing_later_stage_keeps_the_motion(monkeypatch, error):
    def failing(*arguments):
        raise error

    monkeypatch.setattr(descent, "on_finer_grids", failing)
    solution = tm.plan(reach(), tm.Options(refine="grid"))
    assert solution.success and solution.verification.ok
    assert "later stage failed" in solution.message


def test_failing_start_does_not_prevent_other_starts(monkeypatch):
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
def test_replay_may_exceed_the_time_limit_a_little(clock, spent, time_to_replay):
    """A descent that ends at the limit is replayed, but not if it ends 20 % later."""
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


def test_message_says_that_there_was_no_time_for_a_replay(monkeypatch):
    usual, replayed = Candidate.verified, []

    def first_refuted(self, *arguments, **named):
        replayed.append(self.trajectory.duration)
        if len(replayed) > 1:
            raise Stop(requested=False)
        candidate = usual(self, *arguments, **named)
        refuted = replace(candidate.verification, ok=False)
        return replace(candidate, verification=refuted)

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
    """A linear program whose solution takes far longer than LONG."""
    rng = np.random.default_rng(0)
    matrix = sp.random(rows, size, density, random_state=1, format="csc")
    bound, ones = rng.uniform(1.0, 2.0, rows), np.ones(size)
    cost = rng.normal(size=size)
    return LinearProgram(matrix, cost, -ones, ones, -bound, bound)


# Longest wait for the slowest machine [s]; the linear programs would take longer.
LONG = 60.0


@pytest.mark.parametrize("solver", ["highs", "piqp"])
def test_solvers_stop_at_a_deadline(solver):
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
    """Requests are not repeated because a slow machine heeds the first one late."""
    monkeypatch.setattr(stopping, "PATIENCE", LONG)


@pytest.mark.usefixtures("patient")
def test_interrupt_ends_a_run_of_highs():
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


def test_code_without_checks_is_interrupted_after_the_patience(monkeypatch):
    monkeypatch.setattr(stopping, "PATIENCE", 0.2)
    deadline = Deadline()
    with pytest.raises(KeyboardInterrupt), deadline.in_force():
        press()
        end = time.perf_counter() + LONG
        while time.perf_counter() < end:
            time.sleep(0.01)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("patient")
def test_second_interrupt_raises_at_once():
    deadline = Deadline()
    with pytest.raises(KeyboardInterrupt), deadline.in_force():
        press()
        press()
        pytest.fail("the second interrupt was ignored")


def test_too_many_processes_are_refused():
    with pytest.raises(tm.OptionsError, match="processes is 10000, expected"):
        tm.Options(processes=10**4)


def test_callback_receives_every_record():
    seen = []
    solution = tm.plan(
        reach(),
        effort="quick",
        refine=None,
        callback=lambda record: seen.append(record.duration),
    )
    assert [record.duration for record in solution.history] == seen
