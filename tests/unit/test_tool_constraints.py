"""Constraints of tool motion, tool regions and joint couplings: derivatives, bounds,
files.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from constraint_samples import check_terms_against_differences

import tominpmp as tm
from tominpmp.cli.problem import constraint
from tominpmp.constraints.base import States
from tominpmp.exceptions import JointNotFound, ProblemError
from tominpmp.kinematics import RobotKinematics

HALF = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
POSE = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9), np.array([0.1, 0.2, 0.3]))
ITEMS = (
    tm.ToolAcceleration("tool0", 3.0),
    tm.ToolLine("tool0", (0.3, -0.4, 0.2), (0.6, 0.5, 0.9), 0.01),
    tm.ToolLine("tool0", (0.3, 0.1, 0.2), (0.3, 0.1, 0.2), 0.01),
    tm.ToolPolyline("tool0", [(0.3, -0.4, 0.2), (0.6, 0.5, 0.9), (0.1, 0.5, 0.9)]),
    tm.ToolArc("tool0", (0.1, 0.0, 0.4), (0.5, 0.0, 0.4), angle=2.0, radius=0.02),
    tm.ToolArc("tool0", (0.1, 0.0, 0.4), (0.1, 0.0, 0.8), (1.0, 0.0, 0.0)),
    tm.KeepOrientation("tool0", HALF, 0.05),
    tm.AxisFixed("tool0", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    tm.WithinRegion("tool0", (-0.1, -math.inf, 0.0), (0.4, 0.5, 0.8), POSE),
    tm.KeepAway("tool0", (0.3, 0.2, 0.4), 0.3),
    tm.JointCoupling(("wrist_1_joint", "elbow_joint"), (1.0, -2.0), 0.3, -0.2),
)


@pytest.fixture(scope="module")
def ur5():
    return tm.load_robot("ur5", limits="urdf")


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: type(item).__name__)
def test_constraint_derivatives_match_differences(item, ur5):
    check_terms_against_differences(item.on(ur5), 6, 2e-6)


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: type(item).__name__)
def test_rows_are_violated_where_the_measure_exceeds_its_limit(item, ur5):
    item = item.on(ur5)
    rng = np.random.default_rng(5)
    lower, upper = item.bounds(1)
    for _ in range(40):
        q, v, a = (rng.uniform(-2, 2, 6) for _ in range(3))
        states = States(np.zeros(1), q[None], v[None], a[None])
        row = item.evaluate(states)
        over = item.measure(q, v, a) - item.largest > 0.0
        assert bool(np.any((row > upper) | (row < lower))) == over


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: type(item).__name__)
def test_excess_of_many_configurations_matches_that_of_each(item, ur5):
    item, every = item.on(ur5), np.random.default_rng(7).uniform(-2, 2, (3, 5, 6))
    excess, slope = item.excess_at_rest(every)
    for place in np.ndindex(3, 5):
        alone, by_q = item.excess_at_rest(every[place])
        np.testing.assert_allclose(excess[place], alone, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(slope[place], by_q, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("turn", [0.7, 3.0, 5.5])
@pytest.mark.parametrize("height", [0.0, 0.2])
def test_distance_from_the_axis_of_an_arc_is_its_radius(height, turn):
    arc = tm.ToolArc("tip", (0, 0, 1), (2, 0, 1), angle=turn)
    apart, _ = arc.from_curve(np.array([0.0, 0.0, 1.0 + height]))
    assert np.linalg.norm(apart) == pytest.approx(math.hypot(2.0, height))


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: type(item).__name__)
def test_constraints_survive_saving_and_loading(item, ur5, tmp_path):
    free = item if item.order > 1 else None
    start, goal = np.full(6, 0.5), tm.JointGoal(np.full(6, 0.6))
    if free is None:
        item = type(item)(**{**vars(item), **_loose(item)})
    problem = tm.Problem(ur5, start, goal, constraints=(item,), self_collision=False)
    path = tmp_path / "task.toml"
    tm.save_scenario(path, problem)
    assert tm.load_scenario(path).problem.constraints == (item,)


def _loose(item):
    """Values of fields with which nearly any configuration is feasible."""
    wide = {"radius": 9.0, "tolerance": 3.1, "distance": 1e-3}
    if isinstance(item, tm.WithinRegion):
        return {"lower": [-9.0, -np.inf, -9.0], "upper": [9.0, 9.0, 9.0]}
    if isinstance(item, tm.JointCoupling):
        return {"lower": -9.0, "upper": 9.0}
    return {key: wide[key] for key in wide if hasattr(item, key)}


def test_constraints_are_read_from_the_command_line():
    assert constraint(
        "tool_line:frame=tip:start=0,0,1:end=1,0,1:radius=0.02"
    ) == tm.ToolLine("tip", (0, 0, 1), (1, 0, 1), 0.02)
    assert constraint("keep_away:frame=tip:point=0,0,1:distance=0.3") == tm.KeepAway(
        "tip", (0, 0, 1), 0.3
    )
    assert constraint("tool_acceleration:frame=tip:limit=2") == tm.ToolAcceleration(
        "tip", 2.0
    )


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tm.ToolAcceleration("tip", -1), "limit is -1, expected a positive"),
        (lambda: tm.ToolLine("tip", (0, 0), (1, 0, 0)), "start"),
        (lambda: tm.ToolLine("tip", (0, 0, 0), (1, 0, 0), 0.0), "radius is 0.0"),
        (lambda: tm.ToolPolyline("tip", [(0, 0, 0)]), "expected two or more points"),
        (lambda: tm.ToolPolyline("tip", "abc"), "points is 'abc'"),
        (lambda: tm.ToolPolyline("tip", [(0, 0, 0), (1, math.nan, 0)]), "points is"),
        (
            lambda: tm.ToolArc("tip", (0, 0, 0), (0, 0, 1)),
            "expected a vector across the way",
        ),
        (lambda: tm.ToolArc("tip", (0, 0, 0), (1, 0, 0), angle=7.0), "angle is 7.0"),
        (lambda: tm.KeepOrientation("tip", (1, 2, 3)), "rotation"),
        (lambda: tm.WithinRegion("tip", (1, 0, 0), (0, 1, 1)), "lower is"),
        (
            lambda: tm.WithinRegion("tip", [-np.inf] * 3, [np.inf] * 3),
            "the box is infinite",
        ),
        (lambda: tm.KeepAway("tip", (0, 0, 0), 0.0), "distance is 0.0"),
        (lambda: tm.JointCoupling((), (), 1.0), r"joints is \(\), expected names"),
        (lambda: tm.JointCoupling(("a", "a"), (1.0,) * 2, 1.0), r"\('a', 'a'\), exp"),
        (lambda: tm.JointCoupling(("a", "b"), (1.0,), 1.0), "weights"),
        (lambda: tm.JointCoupling(("a",), (1.0,), 1.0, 2.0), "is 2.0 and upper 1.0"),
        (lambda: tm.JointCoupling(("a",), (1.0,), math.nan), "lower is"),
        (lambda: tm.JointCoupling(("a",), (1.0,), "x"), "lower is -inf and upper 'x'"),
        (
            lambda: tm.JointCoupling(("a",), (1.0,), math.inf),
            "only one may be infinite",
        ),
    ],
)
def test_wrong_value_of_a_constraint_is_named(make, words):
    with pytest.raises(ProblemError, match=words):
        make()


@pytest.mark.parametrize(
    ("bounds", "field"),
    [((math.inf,), "upper"), ((1.0, 2.0), "lower"), ((1.0, math.nan), "lower")],
)
def test_wrong_bound_of_a_coupling_is_a_given_one(bounds, field):
    with pytest.raises(ProblemError) as error:
        tm.JointCoupling(("a",), (1.0,), *bounds)
    assert error.value.field == field


def test_unknown_joint_of_a_coupling_is_named(ur5):
    item = tm.JointCoupling(("elbow",), (1.0,), 1.0)
    with pytest.raises(JointNotFound, match="elbow"):
        tm.Problem(ur5, np.zeros(6), tm.JointGoal(np.ones(6)), constraints=(item,))


def test_start_outside_a_tool_line_is_rejected(ur5):
    item = tm.ToolLine("tool0", (5, 5, 5), (6, 6, 6), 0.01)
    with pytest.raises(ProblemError, match="distance from its path of frame tool0 is"):
        tm.Problem(ur5, np.zeros(6), tm.JointGoal(np.ones(6)), constraints=(item,))


def test_goal_velocity_beyond_a_tool_speed_is_rejected(ur5):
    """Regression: a goal of this kind took the whole planning time."""
    q = np.array([1.2, -1.0, 1.3, 0.5, 0.5, 0.0])
    place = RobotKinematics(ur5).placement(q, "tool0")
    fast = tm.PositionGoal("tool0", place.translation, v=[0.8, 0.0, 0.0])
    text = "the speed of frame tool0 is 0.8 m/s, 0.3 m/s more than its limit 0.5 m/s"
    limit = tm.ToolSpeed("tool0", 0.5)
    for goal in (fast, tm.AnyGoal([fast, fast])):
        with pytest.raises(ProblemError, match=text):
            tm.Problem(ur5, 0.9 * q, goal, constraints=[limit])
    for item in (tm.ToolSpeed("wrist_3_link", 0.5), tm.ToolSpeed("tool0", 0.8)):
        tm.Problem(ur5, 0.9 * q, fast, constraints=[item])
    segments = [tm.Segment(fast, constraints=[limit]), tm.Segment(tm.JointGoal(q))]
    with pytest.raises(ProblemError, match=f"segment 1 of 2: goal: {text}"):
        tm.Problem(ur5, 0.9 * q, segments=segments)
