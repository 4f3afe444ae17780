"""More starts, or more processes, never lose a motion that fewer of them find."""

from __future__ import annotations

from itertools import count, pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import tominpmp as tm
from tests.schedules import carried_out
from tominpmp.initial_guess.guess import Guess
from tominpmp.planner import starts
from tominpmp.planner.alternatives import candidates_of_alternatives
from tominpmp.planner.automatic_options import resolve_options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import torque_starts, torques_may_lead
from tominpmp.planner.work import Work
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

START, END = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)
AROUND = tm.Scene([tm.Sphere("O", radius=0.4, position=(3.0, 1.0, 0.0))])


def reach(**changes):
    robot = tm.load_robot("planar3r")
    return tm.Problem(robot, START, tm.JointGoal(END), **changes)


def test_torque_starts_of_a_plan_are_not_repeated():
    """Regression: a thorough search shot four times from the same torques.

    The arm was weak.
    """
    problem = reach()
    state = PlanState(problem, resolve_options(problem, tm.Options()))
    system = ProblemFunctions.of(problem)
    assert len([*torque_starts(system, state, 5)]) == 5
    assert len([*torque_starts(system, state, 7)]) == 2


@pytest.mark.parametrize(
    ("limits", "tried"),
    [
        (None, True),
        (tm.MotionLimits(), True),
        (tm.MotionLimits(effort_scale=0.9), True),
        (tm.MotionLimits(jerk=100.0), False),
    ],
)
def test_torque_starts_are_tried_unless_other_limits_are_bounded(limits, tried):
    """Regression: empty limits and a share of the torques prevented a swing."""
    system = ProblemFunctions.of(reach(motion_limits=limits))
    assert torques_may_lead(system) is tried


class DrawnOutcomes:
    """Descents whose outcomes are drawn beforehand, by the number of the guess."""

    def __init__(self, monkeypatch, seed, finds):
        rng = np.random.default_rng(seed)
        draw = rng.uniform(1.0, 3.0, 40)
        self.outcomes = np.where(rng.uniform(size=40) < finds, draw, np.inf)
        # Durations of the guesses; every second guess is timed by the limits.
        self.predicted = rng.uniform(1.0, 4.0, 40)
        self.shot = float(rng.choice([np.inf, rng.uniform(1.0, 3.0)]))
        self.tried = []
        monkeypatch.setattr(starts, "guesses_of", self.guesses)
        monkeypatch.setattr(starts, "descent_work", self.descent)
        monkeypatch.setattr(starts, "torque_starts", self.torque_starts)
        # No guess is screened on coarse grids first.
        monkeypatch.setattr(starts, "coarse_grids_apply", lambda system, options: False)

    def guesses(self, system, request):
        for number in range(40):
            t = np.array([0.0, self.predicted[number]])
            q = np.array([START, END])
            yield Guess(str(number), t, q, bool(number % 2))

    def descent(self, system, options, guess, state, stop=None):
        def make(*_):
            self.tried.append(guess.name)
            return RankedCandidate(float(self.outcomes[int(guess.name)]))

        return Work(system, make)

    def torque_starts(self, system, state, least):
        def make(*_):
            self.tried.append("shot")
            return RankedCandidate(self.shot)

        yield Work(system, make)


class RankedCandidate:
    """The attributes of a candidate that determine its rank."""

    verification = SimpleNamespace(seconds=0.0)
    status = tm.Status.CONVERGED
    feasible, violation = True, 0.0
    refuted = dropped = False

    def __init__(self, duration):
        self.duration = duration
        self.confirmed = bool(np.isfinite(duration))


def tried_starts(monkeypatch, seed, finds, number, scene):
    """Names of the starts that are tried, and the least duration."""
    drawn = DrawnOutcomes(monkeypatch, seed, finds)
    options = tm.Options(starts=number)
    state = PlanState(reach(scene=scene), options)
    carried_out(state, starts.starts(state, state.problem))
    return drawn.tried, state.best_duration


@pytest.mark.parametrize("scene", [tm.Scene(), AROUND], ids=["alone", "among"])
@pytest.mark.parametrize("finds", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("seed", range(8))
def test_more_starts_begin_with_the_starts_of_fewer(monkeypatch, seed, finds, scene):
    former, least = tried_starts(monkeypatch, seed, finds, None, scene)
    for number in range(1, 13):
        now, T = tried_starts(monkeypatch, seed, finds, number, scene)
        assert now[: len(former)] == former
        assert T <= least
        former, least = now, T


@pytest.mark.parametrize("options", [{"control": "constant"}, {}])
def test_durations_do_not_rise_with_the_number_of_starts(options):
    problem = reach(scene=AROUND)
    options = {"intervals": 20, **options}
    durations = [tm.plan(problem, **options).T]
    for number in (1, 3):
        durations.append(tm.plan(problem, starts=number, **options).T)
    assert all(b <= a for a, b in pairwise(durations))
    assert durations[1] == durations[0]  # by default, a joint goal has one start


def assert_same_motion(one, other):
    assert one.T.hex() == other.T.hex()
    for name in ("t", "q", "v", "u"):
        first = getattr(one.trajectory, name)
        np.testing.assert_array_equal(first, getattr(other.trajectory, name))


def test_one_and_two_processes_find_the_same_motion():
    # Regression: distances, and so motions, depended on earlier queries in their last
    # digits.
    problem = reach(scene=AROUND, margin=0.02)
    alone = tm.plan(problem, starts=2, intervals=20)
    many = tm.plan(problem, starts=2, intervals=20, processes=2)
    assert_same_motion(alone, many)
    # A process does not know the incumbent, and refines a motion that is slower, too.
    assert alone.iterations <= many.iterations


def test_plan_does_not_depend_on_earlier_plans():
    problem = reach(scene=AROUND, margin=0.02)
    few = {"intervals": 24, "effort": "quick", "refine": None}
    before = tm.plan(problem, starts=1, **few)
    tm.plan(problem, starts=2, seed=5, **few)
    assert_same_motion(before, tm.plan(problem, starts=1, **few))


def test_goal_gets_another_turn_after_its_share_of_time():
    """Regression: a goal whose share of the planning time was used up was dropped.

    It was never tried again, though most of the time was left.
    """
    goals = [tm.JointGoal(END), tm.JointGoal(np.array(END) + 0.1)]
    problem = tm.Problem(tm.load_robot("planar3r"), START, tm.AnyGoal(goals))
    state, turns = PlanState(problem, tm.Options()), []
    assert len(problem.alternatives) == 2

    def two_starts(part, former):
        for number in range(2):
            turns.append((problem.alternatives.index(part), number))
            yield SimpleNamespace(replay=True)

    schedule = candidates_of_alternatives(state, two_starts)
    next(schedule)
    for _ in range(3):
        state.cut_short = tm.Status.TIME_LIMIT
        schedule.send(None)
    assert [number for _, number in turns] == [0, 0, 1, 1]
    assert len(set(turns)) == 4


def test_reserve_is_not_subtracted_from_each_share_of_time(clock):
    """Regression: with a limit of 2 s, each of six goals had 0.1 s."""
    state = PlanState(reach(), tm.Options(max_planning_time=2.0))
    state.begin()
    state.share_time(8)
    record = tm.IterationRecord(0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, True, 1, 1, 0.0, 0.0)
    state.kept_iterates = [SimpleNamespace(feasible=False)]
    clock.advance(0.24)
    assert state(record) is None
    clock.advance(0.02)
    with pytest.raises(Stop):
        state(record)


def test_worker_knows_the_incumbent_beside_its_own_candidates():
    """Regression: a candidate without a replay hid the incumbent, and motions were
    slowed down that are slower than it.
    """
    state = PlanState(reach(), tm.Options())
    state.T_to_beat = 1.5
    motion = tm.plan(reach(), effort="quick").trajectory
    state.candidates.append(Candidate(tm.Status.STALLED, True, motion, motion, {}))
    assert state.best_duration == 1.5


def test_share_of_all_the_time_ends_at_the_time_limit(monkeypatch):
    """Regression: the last microseconds of the share were left; the plan continued."""
    state = PlanState(reach(), tm.Options(max_planning_time=2.0))
    times = count(0.3, 1e-6)  # reading the clock takes time
    monkeypatch.setattr(PlanState, "seconds", property(lambda _: next(times)))
    state.share_time(1)
    state.cut_short = tm.Status.TIME_LIMIT
    assert state.ended is tm.Status.TIME_LIMIT
