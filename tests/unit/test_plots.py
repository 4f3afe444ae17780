"""Figures of motions: curves, limits, labels and files."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from motion_samples import (
    planar_motions,
    quintic,
    simple_arm,
)
from sample_arms import describe, slide

from tominpmp.certificate.certificate import ActiveLimit
from tominpmp.exceptions import (
    MissingDependency,
    ProblemError,
    ScenarioError,
)
from tominpmp.goals.joints import JointGoal
from tominpmp.motion.trajectory import Trajectory
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import load_robot
from tominpmp.viz.figures import color
from tominpmp.viz.plots import _plot_limits, curve_states, plot_trajectory

Motions = tuple[Problem, Trajectory, Trajectory]


@pytest.fixture(scope="module")
def motions() -> Motions:
    return planar_motions()


@pytest.fixture(autouse=True)
def settings_stay_as_they_are() -> Iterator[None]:
    before = dict(matplotlib.rcParams)
    yield
    assert dict(matplotlib.rcParams) == before


def solid_lines(panel: Axes) -> list[Line2D]:
    """The curves of a panel, without the dashed limits."""
    return [line for line in panel.get_lines() if line.get_linestyle() != "--"]


def limits(panel: Axes) -> list[float]:
    """The limits drawn in a panel."""
    dashed = [line for line in panel.get_lines() if line.get_linestyle() == "--"]
    return [float(np.asarray(line.get_ydata())[0]) for line in dashed]


def notes(panel: Axes) -> list[str]:
    return [text.get_text() for text in panel.texts]


def legend_texts(figure: Figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def points(line: Line2D) -> np.ndarray:
    return np.column_stack([line.get_xdata(), line.get_ydata()])


# Curves


def test_curve_of_held_torque_is_a_staircase(motions: Motions) -> None:
    held = motions[1]
    times, state = curve_states(held)
    assert times[0] == 0.0
    assert times[-1] == held.duration
    assert np.all(np.diff(times) >= 0.0)
    for k in range(held.t.size - 1):
        inside = (times >= held.t[k]) & (times < held.t[k + 1])
        assert inside.sum() > 10
        assert np.all(state.u[inside] == held.u[k])


def test_curve_has_both_sides_of_a_jump(motions: Motions) -> None:
    braked = motions[2]
    times, state = curve_states(braked)
    switch = braked.t[6]
    before, after = np.flatnonzero(np.abs(times - switch) < 1e-9)
    assert after == before + 1
    np.testing.assert_allclose(state.q[before], state.q[after], atol=1e-12)
    np.testing.assert_array_equal(state.a[before], -state.a[after])
    np.testing.assert_array_equal(state.u[after], braked(switch).u)
    assert np.abs(state.u[before] - state.u[after]).min() > 0.5


# Trajectory


def test_trajectory_shows_all_quantities(motions: Motions) -> None:
    problem, _, braked = motions
    figure = plot_trajectory(problem, braked)
    panels = np.array(figure.axes).reshape(3, 3)
    times, state = curve_states(braked)
    for i in range(3):
        for panel, values in zip(panels[i], (state.q, state.v, state.u), strict=True):
            (curve,) = solid_lines(panel)
            np.testing.assert_array_equal(points(curve)[:, 0], times)
            np.testing.assert_array_equal(points(curve)[:, 1], values[:, i])
            assert curve.get_color() == color(i)
            low, high = panel.get_ylim()
            assert low < values[:, i].min() <= values[:, i].max() < high
    titles = [panel.get_title("left") for panel in panels[0]]
    assert titles == ["position [rad]", "velocity [rad/s]", "torque [N m]"]
    assert [panel.get_xlabel() for panel in panels[2]] == ["time [s]"] * 3
    names = [name for panel in panels[:, 0] for name in notes(panel)]
    assert [name for name in names if "limit" not in name] == list(braked.joint_names)
    assert legend_texts(figure) == ["limit", "beyond it"]


@pytest.mark.parametrize(
    ("name", "first"),
    [
        ("left_manipulator/shoulder_lift_joint", "left_"),
        ("RightElbowPitch", "RightElbow"),
    ],
)
def test_long_joint_names_are_written_in_lines(
    name: str, first: str, tmp_path: Path
) -> None:
    """Regression: letters became smaller, and names met the names of the next rows."""
    path = tmp_path / "arm.urdf"
    path.write_text(describe([slide(1.0)]).replace("joint1", name))
    robot = load_robot(path, effort=1.0, velocity=1.0)
    solution = plan(Problem(robot, [0.0], JointGoal([0.0])))
    (text,) = (t for t in solution.plot().axes[0].texts if "limit" not in t.get_text())
    lines = text.get_text().split("\n")
    assert "".join(lines) == name and lines[0] == first
    assert max(map(len, lines)) <= 14
    assert text.get_fontsize() == 8.0
    assert solution.plot_certificate().axes[0].get_ylabel() == text.get_text()


def test_near_limits_are_drawn_and_far_limits_are_written(motions: Motions) -> None:
    problem, held, _ = motions
    panels = np.array(plot_trajectory(problem, held).axes).reshape(3, 3)
    assert limits(panels[1, 0]) == [-3.0, 3.0]
    assert limits(panels[0, 0]) == [0.18]
    assert "upper limit 3" in notes(panels[0, 0])
    assert limits(panels[0, 1]) == []
    assert notes(panels[0, 1]) == ["limits \u00b1100"]
    assert limits(panels[0, 2]) == [-20.0, 20.0]
    spans = [patch for patch in panels[1, 0].patches if patch.get_alpha() is None]
    assert len(spans) == 2


@pytest.mark.parametrize("n", [1, 4, 14])
def test_trajectory_has_three_panels_for_each_joint(n: int, tmp_path: Path) -> None:
    robot = simple_arm(tmp_path, ["0 0 1"] * n)
    problem = Problem(robot, np.zeros(n), JointGoal(np.full(n, 0.1)))
    motion = quintic(robot, np.zeros(n), np.full(n, 0.1), 1.0, 5)
    figure = plot_trajectory(problem, motion)
    panels = [panel for panel in figure.axes if panel.axison]
    assert len(panels) == 3 * n
    assert len({solid_lines(panel)[0].get_color() for panel in panels}) == n
    # No panel is squeezed to nothing.
    figure.canvas.draw()
    assert min(panel.get_window_extent().height for panel in panels) > 50.0


def test_sliding_joints_have_their_units(tmp_path: Path) -> None:
    robot = simple_arm(tmp_path, ["1 0 0", "0 0 1"], ["prismatic", "revolute"])
    problem = Problem(robot, np.zeros(2), JointGoal([0.1, 0.2]))
    motion = quintic(robot, [0.0, 0.0], [0.1, 0.2], 1.0, 5)
    panels = np.array(plot_trajectory(problem, motion).axes).reshape(2, 3)
    assert [panel.get_ylabel() for panel in panels[0]] == ["[m]", "[m/s]", "[N]"]
    assert [panel.get_ylabel() for panel in panels[1]] == ["[rad]", "[rad/s]", "[N m]"]


def test_long_joint_names_stay_beside_the_labels_of_the_axis(tmp_path: Path) -> None:
    """Regression: the lines of a name were centred, and met the units and numbers.

    A name of 960 letters left an eighth of the figure for a panel.
    """
    robot = simple_arm(tmp_path, ["1 0 0", "0 0 1"], ["prismatic", "revolute"])
    name = 20 * "a_joint_of_the_linear_axis_with_a_very_long_name"
    text = robot.urdf_path.read_text(encoding="utf-8")
    first = robot.joint_names[0]
    robot.urdf_path.write_text(text.replace(f'"{first}"', f'"{name}"'))
    robot = load_robot(robot.urdf_path)
    problem = Problem(robot, np.zeros(2), JointGoal([0.1, 0.2]))
    motion = quintic(robot, [0.0, 0.0], [0.1, 0.2], 1.0, 5)
    figure = plot_trajectory(problem, motion)
    figure.canvas.draw()
    panel = figure.axes[0]
    (shown,) = (t for t in panel.texts if "limit" not in t.get_text())
    assert shown.get_text().count("\n") >= 3
    assert shown.get_window_extent().x1 < panel.yaxis.label.get_window_extent().x0
    assert panel.get_window_extent().width > 0.2 * figure.bbox.width


def test_long_names_leave_room_for_the_bars(tmp_path: Path) -> None:
    """Regression: a long name of a joint left a fraction of the figure for the bars."""
    name = "a_joint_of_the_linear_axis_with_a_very_long_name"
    path = tmp_path / "arm.urdf"
    path.write_text(describe([slide(1.0)]).replace("joint1", name))
    robot = load_robot(path, effort=1.0, velocity=1.0)
    found = plan(Problem(robot, [0.0], JointGoal([1.0])), effort="quick", refine=None)
    figure = found.sensitivities.plot()
    labels = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert "a_joint_of_the_linea\u2026y_long_name: effort  +1 %" in labels


def test_rounding_of_a_joint_at_rest_is_not_magnified(motions: Motions) -> None:
    """Regression: rounding filled the panel; its power of ten met the next column."""
    problem, held, _ = motions
    rest = replace(held, v=1e-13 * np.sin(np.arange(held.v.size).reshape(held.v.shape)))
    for panel in plot_trajectory(problem, rest).axes[1::3]:
        assert np.ptp(panel.get_ylim()) > 0.01


# Files and wrong arguments


def test_names_that_look_like_formulas_are_shown_verbatim(
    tmp_path: Path,
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(describe([slide(1.0)]).replace("joint1", r"$\frac{$"))
    robot = load_robot(path, effort=1.0, velocity=1.0)
    motion = quintic(robot, [0.0], [1.0], 1.0, 5)
    problem = Problem(robot, [0.0], JointGoal([1.0]))
    plot_trajectory(problem, motion, tmp_path / "formula.svg")
    assert "frac{$" in (tmp_path / "formula.svg").read_text("utf-8")


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_figures_are_written(motions: Motions, ending: str, tmp_path: Path) -> None:
    problem, held, _ = motions
    path = tmp_path / f"figure.{ending}"
    figure = plot_trajectory(problem, held, path)
    assert isinstance(figure, Figure)
    content = path.read_bytes()
    start = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[ending]
    assert content.startswith(start)
    if ending == "png":
        pixels = imread(path)
        assert min(pixels.shape[:2]) > 300
        assert pixels[..., :3].std() > 0.05
    plot_trajectory(problem, held, path)
    assert path.read_bytes() == content


def test_wrong_arguments_are_refused_and_no_file_is_written(
    motions: Motions, tmp_path: Path
) -> None:
    problem, held, _ = motions
    with pytest.raises(ProblemError, match=r"not written as \.xyz; there are: .*png"):
        plot_trajectory(problem, held, tmp_path / "figure.xyz")
    with pytest.raises(ScenarioError, match="there is no folder"):
        plot_trajectory(problem, held, tmp_path / "nowhere" / "figure.png")
    robot = simple_arm(tmp_path, ["0 0 1"] * 2)
    other = quintic(robot, [0.0, 0.0], [0.1, 0.2], 1.0, 5)
    with pytest.raises(ProblemError, match="expected a motion of joint1, joint2"):
        plot_trajectory(problem, other)
    assert list(tmp_path.glob("*.png")) == []


def test_error_without_matplotlib_names_the_extra(
    motions: Motions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependency, match=r"tominpmp\[plots\]") as caught:
        plot_trajectory(motions[0], motions[1])
    assert caught.value.extra == "plots"


def test_no_pyplot_figure_is_left_open(motions: Motions) -> None:
    from matplotlib import pyplot

    plot_trajectory(motions[0], motions[1])
    assert pyplot.get_fignums() == []


def test_limits_of_a_certificate_name_their_subject_once() -> None:
    ones = np.ones(1)
    limits = [
        (ActiveLimit(kind, name, 0.0 * ones, ones, ones, ones > 0), "C0")
        for kind, name in (("speed of frame tip", "frame tip"), ("effort", "joint1"))
    ]
    panel = Figure().subplots()
    _plot_limits(panel, limits)
    labels = [text.get_text() for text in panel.get_yticklabels()]
    assert labels == ["speed of frame tip", "effort, joint1"]
    _plot_limits(panel, [])
    labels = [text.get_text() for text in panel.get_yticklabels()]
    assert labels == ["no limit holds the motion"]
