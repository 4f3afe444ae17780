"""Path constraints with a time window."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

import tominpmp as tm
from tests.sample_arms import make_arm, slide
from tominpmp.cli.problem import constraint
from tominpmp.constraints.base import States
from tominpmp.constraints.path import EMPTY, PathConstraint
from tominpmp.exceptions import ProblemError
from tominpmp.transcription.bspline import InverseTranscription
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

QUICK = {"intervals": 24, "refine": None, "effort": "quick", "starts": 1}


def rail(*constraints, distance: float = 1.0, effort: float = 1.0) -> tm.Problem:
    arm = make_arm(slide(1.0), effort=np.array([effort]))
    goal = tm.JointGoal([distance])
    return tm.Problem(arm, [0.0], goal, constraints=constraints)


def duration_with_a_slow_beginning(slow: float, until: float) -> float:
    """Closed form of T from 0 to 1 at 1 m/s^2 with a speed limit until some time.

    The rail accelerates to w, keeps w until then, and is time-optimal from there.
    """
    travelled = slow * until - 0.5 * slow**2
    left = 1.0 - travelled
    # From the speed w, up to the peak and down to rest over the remaining distance.
    peak = math.sqrt(left + 0.5 * slow**2)
    return until + (peak - slow) + peak


@pytest.mark.parametrize("intervals", [16, 40])
def test_torques_between_rows_keep_the_limit_of_a_time_window(intervals):
    """Regression: short intervals at the start had no row, and their torques were at
    the limits.
    """
    slow = tm.ToolAcceleration("tip", 0.5, during=(0.0, 0.5))
    options = {**QUICK, "intervals": intervals, "method": "collocation"}
    solution = tm.plan(rail(slow), **options)
    assert solution.success, solution.message
    assert solution.iterations < 40
    times = np.linspace(0.0, 0.49, 500)
    assert np.max(np.abs(solution.trajectory(times).u)) <= 0.5 * 1.006


@pytest.mark.parametrize("method", ["inverse", "collocation"])
def test_speed_limit_at_the_beginning_matches_the_closed_form(method):
    slow = tm.ToolSpeed("tip", 0.3, during=(0.0, 0.8))
    solution = tm.plan(rail(slow), method=method, **QUICK)
    assert solution.success, solution.message
    expected = duration_with_a_slow_beginning(0.3, 0.8)
    assert pytest.approx(expected, rel=1e-2) == solution.T
    v = solution.trajectory(np.linspace(0.0, 0.8, 400)).v
    assert np.abs(v).max() < 0.3 * 1.006
    assert np.abs(solution.trajectory.v).max() > 0.5


def test_time_window_without_an_end_holds_until_the_goal():
    slow = tm.ToolSpeed("tip", 0.3, during=(0.8, math.inf))
    solution = tm.plan(rail(slow), **QUICK)
    assert solution.success, solution.message
    late = solution.trajectory(np.linspace(0.8, solution.T, 400)).v
    assert np.abs(late).max() < 0.3 * 1.006
    peak = 0.5 * (0.8 + 0.3)
    travelled = peak**2 - 0.5 * 0.3**2
    fastest = 0.8 + (1.0 - travelled - 0.5 * 0.3**2) / 0.3 + 0.3
    assert 0.995 < solution.T / fastest < 1.03  # a coarse grid has no switch at 0.8 s


@pytest.mark.parametrize(("until", "middle"), [(2.5, 1.0), (6.0, 1.0), (3.0, 0.5)])
def test_arm_waits_with_a_run_up_for_a_region_that_opens_later(until, middle):
    """With a run-up, the rail is at full braking speed when the region opens.

    It passes the near side with the speed from which it can just stop at the goal.
    """
    away = tm.KeepAway("tip", (middle, 0, 0), 0.3, during=(0.0, until))
    solution = tm.plan(rail(away, distance=2.0, effort=2.0), effort="quick")
    assert solution.success, solution.message
    left = 2.0 - (middle - 0.3)
    expected = until + math.sqrt(2.0 * left / 2.0)
    assert pytest.approx(expected, rel=2e-3) == solution.T
    q = solution.trajectory(np.linspace(0.0, until, 800)).q[:, 0]
    assert q.max() < middle - 0.3 + 1e-3


def test_goal_in_a_forbidden_region_is_reached_after_its_window():
    """The goal is only free after the time window, and the arm arrives as soon as
    possible.
    """
    away = tm.KeepAway("tip", (1.0, 0, 0), 0.3, during=(0.5, 2.0))
    solution = tm.plan(rail(away, effort=2.0), effort="quick")
    assert solution.success, solution.message
    assert pytest.approx(2.0 + math.sqrt(0.3), rel=2e-3) == solution.T


def test_time_window_after_the_end_does_not_change_the_motion():
    """A motion is neither hurried to escape a time window, nor slowed down by it."""
    near = tm.WithinRegion("tip", (0.9, -9, -9), (9, 9, 9), during=(3.0, 4.0))
    solution = tm.plan(rail(near), **QUICK)
    assert pytest.approx(2.0, rel=5e-3) == solution.T


def test_replay_checks_a_constraint_only_in_its_time_window():
    motion = tm.plan(rail(), **QUICK).trajectory
    inside = rail(tm.ToolSpeed("tip", 0.5, during=(0.8, 1.2)))
    verdict = tm.verify(inside, motion)
    assert not verdict.ok and "speed of frame tip is" in verdict.message
    outside = rail(tm.ToolSpeed("tip", 0.5, during=(0.0, 0.45)))
    assert tm.verify(outside, motion).ok


@dataclass(frozen=True, eq=False)
class JointSpeed(PathConstraint):
    """A limit of the speeds alone: its derivatives by the positions are zero."""

    name = "speed of the joints"
    subject = "the joints"
    unit = "m/s"
    largest = 0.3
    order = 1

    def validate(self, robot):
        """Suit every robot."""

    def measure(self, q, v, a):
        return float(np.linalg.norm(v))

    def vector(self, q, v, a):
        return v, EMPTY, np.eye(v.size), EMPTY


@pytest.mark.parametrize("number", range(2))
@pytest.mark.parametrize(
    "item",
    [
        JointSpeed(during=(0.4, 0.9)),
        tm.KeepAway("tip", (0.2, 0.1, 0.0), 0.3, during=(0.4, 0.9)),
        tm.ToolSpeed("tip", 0.3, during=(0.4, 0.9)),
        tm.ToolAcceleration("tip", 0.7, during=(0.4, 0.9)),
    ],
    ids=lambda item: type(item).__name__,
)
def test_rows_of_time_windows_match_differences(number, item):
    arm = make_arm(slide(1.0), slide(1.0, (0, 1, 0)), effort=np.array([5.0, 5.0]))
    problem = tm.Problem(arm, [0.0, 0.0], tm.JointGoal([1.0, 0.5]), constraints=(item,))
    system = ProblemFunctions.of(problem)
    shares = np.full((6, 1), 1.0 / 6.0)

    def path(t):
        share = np.atleast_1d(t)[:, None] / 2.0
        return share**2 * (3.0 - 2.0 * share) * np.array([1.0, 0.5])

    kind = CollocationTranscription if number else InverseTranscription
    of = kind(system, shares, 2.0)
    z = of.start(path, 2.0, np.array([2.0]))
    z = z + 1e-2 * np.random.default_rng(1).standard_normal(z.size)
    program = NonlinearProgram.of(of)
    block = next(b for b in program.blocks if b.name == item.name)
    every = np.arange(block.bounds[0].size)
    jacobian = block.jacobian(of.motion(z), every)
    d = np.random.default_rng(2).standard_normal(z.size)
    ends = [block.values(of.motion(z + s * 1e-6 * d)) for s in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / 2e-6
    # Accelerations jump between the intervals, and rows at times with them.
    smooth = np.abs(slope) < 1e3
    np.testing.assert_allclose((jacobian @ d)[smooth], slope[smooth], atol=2e-5)
    assert smooth.sum() > 15


def test_time_windows_are_read_from_files_and_the_command_line(tmp_path):
    item = tm.KeepAway("tip", (5.0, 0.0, 0.0), 0.3, during=(0.25, math.inf))
    robot = tm.load_robot("planar3r", gravity=(0, 0, 0))
    goal = tm.JointGoal([0.6, 0.5, 0.4])
    problem = tm.Problem(robot, [0.5, 0.5, 0.5], goal, constraints=(item,))
    path = tmp_path / "task.toml"
    tm.save_scenario(path, problem)
    assert tm.load_scenario(path).problem.constraints == (item,)
    given = constraint("tool_speed:frame=tip:limit=0.5:during=0.2,0.6")
    assert given == tm.ToolSpeed("tip", 0.5, during=(0.2, 0.6))


def test_start_is_checked_only_if_it_is_in_the_time_window():
    far = {"lower": (0.5, -9, -9), "upper": (9, 9, 9)}
    with pytest.raises(ProblemError, match="start: the distance from its region"):
        rail(tm.WithinRegion("tip", **far, during=(0.0, 1.0)))
    rail(tm.WithinRegion("tip", **far, during=(0.1, 1.0)))


@pytest.mark.parametrize(
    "during", [5.0, (1.0,), (2.0, 1.0), (-1.0, 1.0), (0.0, math.nan), ("a", 2), "ab"]
)
def test_wrong_time_window_is_rejected(during):
    with pytest.raises(ProblemError, match=r"during is .*, expected two times"):
        tm.ToolSpeed("tip", 1.0, during=during)


def test_segments_reject_constraints_with_time_windows():
    slow = tm.ToolSpeed("tip", 0.5, during=(0.0, 1.0))
    arm = rail().robot
    parts = [tm.Segment(tm.JointGoal([q])) for q in (0.5, 1.0)]
    for some in (parts, parts[:1]):
        with pytest.raises(ProblemError, match=r"during is .* the problem has segm"):
            tm.Problem(arm, [0.0], segments=some, constraints=(slow,))


def test_measures_of_no_states_are_empty():
    ready = tm.ToolSpeed("tip", 0.5, during=(0.0, 1.0)).on(rail().robot)
    none = np.zeros((0, 1))
    assert ready.sizes(np.zeros(0), none, none, none).shape == (0,)
    assert ready.measures(States(np.zeros(0), none, none, none)).shape == (0,)
