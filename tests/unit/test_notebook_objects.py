"""HTML of objects in notebooks, derivatives of trajectories, plots on given axes."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest
from scipy.interpolate import PPoly

import tominpmp as tm


@pytest.fixture(scope="module")
def solution() -> tm.Solution:
    robot = tm.load_robot("planar3r")
    problem = tm.Problem(robot, [0.5, 1.7, -1.7], tm.JointGoal([2, -1, 0.5]))
    return tm.plan(problem, intervals=12, effort="quick")


def test_notebooks_show_a_picture_and_a_table(solution: tm.Solution) -> None:
    parts = (solution, solution.problem, solution.problem.robot, solution.trajectory)
    for item in parts:
        page = fromstring(item._repr_html_())  # well formed
        assert next(page.iter("{http://www.w3.org/2000/svg}polyline"), None) is not None
        assert next(page.iter("td"), None) is not None
        assert len(item._repr_html_()) < 60_000
    assert "joint2" in solution.trajectory._repr_html_()


def test_a_goal_without_a_configuration_is_not_drawn(solution: tm.Solution) -> None:
    """Regression: the start was drawn in the place of the goal."""
    robot, start = solution.problem.robot, solution.problem.q_start
    point = tm.Problem(robot, start, tm.PositionGoal("tip", (4.0, 1.0, 0.0)))
    assert "goal in grey" in solution.problem._repr_html_()
    assert "goal in grey" not in point._repr_html_()


def test_joint_names_are_escaped_in_html() -> None:
    name = "<script>alert(1)</script>"
    q = np.array([[0.0], [1.0]])
    motion = tm.Trajectory((name,), [0.0, 1.0], q, 0 * q, np.nan * q)
    assert "<script>" not in motion._repr_html_()
    assert "&lt;script&gt;" in motion._repr_html_()


def test_solution_without_a_motion_has_html(solution: tm.Solution) -> None:
    failed = copy.copy(solution)
    object.__setattr__(failed, "trajectory", None)
    assert "No motion" in fromstring(failed._repr_html_()).findtext("b")


def test_long_texts_in_a_card_are_whole_and_not_quoted(solution: tm.Solution) -> None:
    """Regression: the reason of a lower bound was cut, and stood in quotes."""
    bound = replace(solution.lower_bound, reason=" ".join(["the slowest joint"] * 9))
    page = fromstring(replace(solution, lower_bound=bound)._repr_html_())
    texts = [cell.text for cell in page.iter("td")]
    assert bound.in_words(solution.T) in texts and solution.message in texts


def motions() -> list[tm.Trajectory]:
    rng = np.random.default_rng(0)
    t = np.cumsum(np.r_[0.0, rng.uniform(0.1, 0.5, 4)])
    v, a = rng.normal(size=(5, 2)), rng.normal(size=(5, 2))
    h = np.diff(t)[:, None]
    constant = np.diff(v, axis=0) / h
    q = np.vstack([np.zeros(2), np.cumsum(h * 0.5 * (v[:-1] + v[1:]), axis=0)])
    names = ("a", "b")
    return [
        tm.Trajectory(names, t, q, v, 0 * q, constant),
        tm.Trajectory(names, t, q, v, 0 * q),
        tm.Trajectory(names, t, q, v, 0 * q, a),
    ]


@pytest.mark.parametrize("motion", motions(), ids=["degree 2", "degree 3", "degree 5"])
def test_derivatives_agree_with_the_states_of_the_motion(motion: tm.Trajectory) -> None:
    times = np.linspace(0.0, motion.duration, 57)
    state = motion(times)
    for nu, values in enumerate(state[:3]):
        found = motion.derivative(nu)
        assert isinstance(found, PPoly)
        np.testing.assert_allclose(found(times), values, atol=1e-9)
        np.testing.assert_array_equal(motion(times, nu), found(times))
        np.testing.assert_array_equal(motion(times[3], nu=nu), found(times[3]))
        assert np.isnan(found(motion.duration + 1.0)).all()
    later = times[1:-1] + 1e-7
    slope = (motion(later, 2) - motion(later - 1e-7, 2)) / 1e-7
    np.testing.assert_allclose(motion(times[1:-1], 3), slope, atol=1e-3)
    integral = motion.derivative().antiderivative()(motion.duration)
    np.testing.assert_allclose(integral, motion.q[-1] - motion.q[0], atol=1e-9)


def test_derivatives_outside_of_a_motion_are_refused_unless_held() -> None:
    motion = motions()[1]
    with pytest.raises(tm.ProblemError, match="outside of the motion"):
        motion(99.0, 1)
    np.testing.assert_array_equal(motion(99.0, 1, hold=True), [0.0, 0.0])
    np.testing.assert_allclose(motion(99.0, 0, hold=True), motion.q[-1])
    for nu in (-1, 1.5, "1", True, np.zeros(2)):
        with pytest.raises(tm.ProblemError, match=r"nu is .*, expected an integer"):
            motion.derivative(nu)


def test_plots_are_drawn_on_axes_of_the_caller(solution: tm.Solution) -> None:
    figure_of = pytest.importorskip("matplotlib.figure").Figure
    figure = figure_of()
    one = figure.subplots()
    assert solution.plot(ax=one) is figure
    assert len(one.lines) == 3 + 2  # the joints and the limits
    figure = figure_of()
    three = figure.subplots(3)
    assert solution.plot(ax=three) is figure
    assert [len(panel.lines) for panel in three] == [3, 3, 3]
    for wrong in (5, "x", list(three[:2]), [None] * 3, figure):
        with pytest.raises(tm.ProblemError, match=r"ax is .*, expected one or three"):
            solution.plot(ax=wrong)


@pytest.mark.parametrize(
    "item",
    [
        tm.JointGoal([1.0, 2.0]),
        tm.JointGoal({"a": 1.0, "b": 2.0}),
        tm.PoseGoal("tip", np.eye(4)),
        tm.RegionGoal("tip", (0, 0, 0), (1, 1, 1), pose=np.eye(4)),
        tm.AnyGoal([tm.JointGoal([1.0])]),
        tm.Scene([tm.Box("b", size=(1, 1, 1))]),
        tm.Payload(1.0, "tip", geometry=[tm.Sphere("s", radius=0.1)]),
        tm.MotionLimits(acceleration=1.0),
        tm.Options(intervals=20),
        tm.Segment(tm.JointGoal([1.0])),
        tm.KeepUpright("tip"),
        tm.ToolSpeed("tip", 0.2),
        tm.Tolerances(),
        tm.EffortCurve([0, 1], [2, 1]),
        tm.ConstantVelocity((1, 0, 0)),
    ],
    ids=lambda item: type(item).__name__,
)
def test_public_objects_copy_pickle_and_have_a_one_line_repr(item: object) -> None:
    for twin in (
        copy.deepcopy(item),
        copy.copy(item),
        pickle.loads(pickle.dumps(item)),
    ):
        assert twin == item
        assert hash(twin) == hash(item)
    text = repr(item)
    assert type(item).__name__ in text
    assert len(text) <= 320
    assert "\n" not in text
    assert item != object()
