"""Plots of motions over time, of certificates and sensitivities."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.certificate.certificate import ActiveLimit, Certificate
from tominpmp.certificate.dwells import without_dwells
from tominpmp.checks import instance, whole, wrong
from tominpmp.kinematics import prismatic_joints
from tominpmp.motion.trajectory import State, Trajectory
from tominpmp.notebook import GREY, LIMIT_COLOR
from tominpmp.problem.joint_limits import JointBounds, controls_in, joint_limits
from tominpmp.problem.problem import Problem
from tominpmp.sensitivities.records import LEAST, Sensitivities, names_subject
from tominpmp.viz import figures
from tominpmp.viz.shares import Shares, shares_of_limits, times_with_jumps
from tominpmp.viz.skeleton import check_motions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Least number of points drawn of a motion, so that curves look smooth.
CURVE_POINTS = 500
# Length of the time axis of a motion of zero duration [s].
MOMENT = 1e-3
# Distance of a limit, as a multiple of the largest value, beyond which the limit is
# written instead of drawn: the curve would look flat.
FAR_LIMIT = 2.5
# Lines at the ends of segments: darker than the grid, lighter than the axes.
SEGMENT_COLOR = "0.55"
HAMILTONIAN_COLOR = "#5b4b8a"
SWITCHING_LOOK: dict[str, Any] = {"color": "#2b3440", "linewidth": 0.9}
# Range of the torque axis in the plot of a certificate, in shares of the limits.
BEYOND = 1.12
# Number of collision pairs shown, which are those with the largest multipliers.
MOST_PAIRS = 8


def _quantities(problem: Problem, state: State) -> list[tuple[str, JointBounds, Array]]:
    """Positions, velocities and controls with their names and limits."""
    values = state.q, state.v, controls_in(problem.robot, state)
    limits = joint_limits(problem.robot, problem.motion_limits)[: len(values)]
    names = [item.kind.name.replace("effort", "torque") for item in limits]
    return list(zip(names, limits, values, strict=True))


def plot_trajectory(
    problem: Problem, trajectory: Trajectory, path: str | Path | None = None
) -> Figure:
    """Plot positions, velocities and torques over time, with their limits.

    Args:
        problem: The problem, for the limits of its robot.
        trajectory: The motion.
        path: File to write (PNG, PDF or SVG by its ending), if any.

    Returns:
        The figure: one row for each joint, one column for each quantity.

    Raises:
        ProblemError: If the motion is not one of the problem's robot, or the ending of
            the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motions(problem, [trajectory])
    robot = problem.robot
    times, state = curve_states(trajectory)
    slides = prismatic_joints(robot).tolist()
    mixed = any(slides) and not all(slides)
    with figures.styled():
        figure = figures.new_figure(9.0, max(2.6, 0.7 + 1.15 * robot.n))
        # The time to share axes or align labels is quadratic in the number of panels.
        axes = figure.subplots(robot.n, 3, squeeze=False)
        for column, (name, item, values) in enumerate(_quantities(problem, state)):
            units = item.kind.units
            for i, panel in enumerate(axes[:, column]):
                panel.plot(times, values[:, i], color=figures.color(i))
                _show_limits(panel, values[:, i], item.lower[i], item.upper[i])
                panel.tick_params(labelbottom=i == robot.n - 1)
                if mixed:
                    panel.set_ylabel(f"[{units[slides[i]]}]", labelpad=2.0)
            title = "force" if name == "torque" and all(slides) else name
            title += "" if mixed else f" [{units[slides[0]]}]"
            axes[0, column].set_title(title)
        for i, joint in enumerate(robot.joint_names):
            # Further lines of a name go to the left, away from the labels of the axis.
            look = _name_look(i) | {"ha": "right", "va": "center"}
            look |= {"rotation": 90, "transform": axes[i, 0].transAxes}
            axes[i, 0].text(-0.32, 0.5, _in_lines(joint), **look)
        _time_axes(axes, trajectory.duration)
        for panel in axes.reshape(-1):
            for end in trajectory._ends[:-1]:
                panel.axvline(end, color=SEGMENT_COLOR, linewidth=0.6, zorder=0.8)
        figures.add_legend(figure, 2)
        return figures.finish(figure, path)


def plot_on_axes(
    problem: Problem,
    trajectory: Trajectory,
    ax: Axes | Sequence[Axes],
    path: str | Path | None = None,
) -> Figure:
    """Draw a motion on one or three axes of matplotlib.

    Args:
        problem: The problem, for the limits of its robot.
        trajectory: The motion.
        ax: One axes object, for torques as shares of their limits, or three, for
            positions, velocities and torques.
        path: File to write the figure of the axes to, if any.

    Returns:
        The figure of the axes.

    Raises:
        ProblemError: If ``ax`` is not one or three axes of matplotlib, the motion is
            not one of the problem's robot, or the ending of the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motions(problem, [trajectory])
    with figures.styled():
        from matplotlib.axes import Axes

        panels: list[Any] = list(np.ravel(np.asarray(ax, object)))
        if len(panels) not in (1, 3) or not all(isinstance(a, Axes) for a in panels):
            raise wrong(ax, "ax", "one or three axes of matplotlib")
    times, state = curve_states(trajectory)
    quantities = _quantities(problem, state)
    titled = [(f"{name} [{item.kind.unit}]", rows) for name, item, rows in quantities]
    if len(panels) == 1:
        shares = shares_of_limits(problem, trajectory, times)
        titled = [(f"{shares.control} over its limit", shares.torque)]
        for at in (-1.0, 1.0):
            panels[0].axhline(at, **figures.LIMIT_LOOK)
    for panel, (title, values) in zip(panels, titled, strict=True):
        for i, name in enumerate(problem.robot.joint_names):
            panel.plot(times, values[:, i], color=figures.color(i), label=name)
        panel.set_title(title, loc="left")
        panel.set_xlabel("time [s]")
    panels[-1].legend(fontsize="small")
    figure: Figure = panels[0].figure
    return figures.finish(figure, path)


def plot_certificate(
    problem: Problem,
    trajectory: Trajectory,
    certificate: Certificate,
    path: str | Path | None = None,
) -> Figure:
    """Plot the quantities of a certificate over time.

    Each joint has a panel with its torque in shares of its limits, and its switching
    function on a reversed axis, so that the torque of an optimal motion is at the
    limit on whose side the switching function is. Below are the active limits and the
    Hamiltonian. Dwells are left out, as in the times of the certificate.

    Args:
        problem: The problem, for the limits of its robot.
        trajectory: The motion.
        certificate: Its certificate.
        path: File to write (PNG, PDF or SVG by its ending), if any.

    Raises:
        ProblemError: If the motion is not one of the problem's robot, or the ending of
            the path is unknown.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    check_motions(problem, [trajectory])
    instance(certificate, Certificate, "certificate")
    problem, trajectory = without_dwells(problem, trajectory)
    n, times = problem.robot.n, curve_states(trajectory)[0]
    shares = shares_of_limits(problem, trajectory, times)
    limits = _limits_shown(certificate.active, shares.joint_names)
    # Heights of the panels [in]: one for each joint, the bars, the Hamiltonian.
    heights = [*[0.95] * n, 0.2 * max(len(limits), 1) + 0.15, 1.0]
    verdict = "kept" if certificate.ok else "NOT kept"
    with figures.styled():
        figure = figures.new_figure(9.0, sum(heights) + 1.3)
        axes = figure.subplots(n + 2, 1, sharex=True, height_ratios=heights)
        for joint in range(n):
            _plot_joint(axes[joint], shares, certificate, joint)
        _plot_limits(axes[n], limits)
        last, values = axes[-1], certificate.hamiltonian
        last.axhline(0.0, color=GREY, linewidth=0.8)
        look = {"color": HAMILTONIAN_COLOR, "label": "Hamiltonian H"}
        last.stairs(values, certificate.t, baseline=None, **look)
        largest = max(1.2 * np.max(np.abs(values), initial=0.0), 0.05)
        last.set_ylim(-largest, largest)
        last.set_ylabel("H", rotation=0, labelpad=10.0)
        _time_axes(axes[:, None], trajectory.duration)
        axes[0].set_title(
            f"first-order conditions {verdict}: small changes promise "
            f"{100 * certificate.stationarity:.2g} % of T, signs obeyed "
            f"{100 * certificate.sign_share:.1f} % of the time"
        )
        figures.add_legend(figure, 4)
        return figures.finish(figure, path)


def plot_sensitivities(
    sensitivities: Sensitivities, path: str | Path | None = None, *, most: int = 20
) -> Figure:
    """Draw by how much T changes with one per cent, or a millimetre, of each limit.

    Args:
        sensitivities: Sensitivities of a motion.
        path: File to write (PNG, PDF or SVG by its ending), if any.
        most: Largest number of bars.

    Raises:
        ProblemError: If the ending of the path is unknown, or the number is wrong.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    instance(sensitivities, Sensitivities, "sensitivities", "Sensitivities of a motion")
    most = whole(most, "most", least=1, expected="a number of bars >= 1")
    shown = [item for item in sensitivities if abs(item.effect) >= LEAST][:most]
    bars = max(len(shown), 1)
    with figures.styled():
        figure = figures.new_figure(7.0, 0.24 * bars + 1.0)
        panel = figure.subplots()
        labels = [f"{_short(k.label)}  +{k.more}" for k in shown]
        for place, item in enumerate(shown):
            side = figures.color(2 if item.effect < 0.0 else 1)
            bar = panel.barh(place, 100.0 * item.effect, color=side, height=0.7)
            panel.bar_label(bar, fmt="{:.2g}", padding=3, fontsize=7.0)
        panel.margins(x=0.12)
        panel.axvline(0.0, color="#4a5867", linewidth=0.7)
        panel.set_yticks(range(len(shown)), labels)
        panel.set_ylim(bars - 0.4, -0.6)
        panel.grid(False, axis="y")
        title = f"what holds T = {sensitivities.T:.4g} s"
        panel.set(title=title, xlabel="change of T [%]")
        return figures.finish(figure, path)


def curve_states(trajectory: Trajectory) -> tuple[Array, State]:
    """Sample a motion for drawing, with both sides of every jump at a node.

    A motion of zero duration is held for a moment.
    """
    times = np.array([0.0, MOMENT])
    if trajectory.duration > 0.0:
        times = times_with_jumps(trajectory, CURVE_POINTS)
    return times, trajectory(times, hold=True)


def _time_axes(panels: Any, duration: float) -> None:
    """Let time run from 0 to the end of a motion, and name it below the last row.

    Args:
        panels: The panels, shape (rows, columns).
        duration: The end [s]; for zero, a short time is shown.
    """
    for panel in panels.reshape(-1):
        panel.set_xlim(0.0, duration or MOMENT)
    for panel in panels[-1]:
        panel.set_xlabel("time [s]")


def _in_lines(name: str) -> str:
    """The name of a joint in a few lines that fit next to its row."""
    ends = r"[ /_-]|(?<=[a-z])(?=[A-Z])|$"
    return "\n".join(re.findall(rf".{{1,13}}(?:{ends})|.{{1,13}}", _short(name, 80)))


def _short(name: str, most: int = 40) -> str:
    """A name, without its middle if it is long: names of pairs differ at both ends."""
    short = f"{name[: most // 2]}\u2026{name[most // 2 + 1 - most :]}"
    return name if len(name) <= most else short


def _name_look(joint: int) -> dict[str, Any]:
    """Text properties of the name of a joint."""
    return {"fontsize": 8.0, "fontweight": "bold", "color": figures.color(joint)}


def _show_limit(panel: Axes, limit: float, edge: float, *labels: str) -> None:
    """Draw a limit, and shade the area between it and an edge of the panel."""
    line = panel.axhline(limit, **figures.LIMIT_LOOK)
    area = panel.axhspan(limit, edge, color=figures.BEYOND_COLOR, lw=0.0, zorder=0.5)
    for artist, label in zip((line, area), labels, strict=False):
        artist.set_label(label)


def _show_limits(panel: Axes, values: Array, lower: float, upper: float) -> None:
    """Draw limits near to the values, and write the values of distant limits."""
    low, high = float(values.min()), float(values.max())
    reach = FAR_LIMIT * max(abs(low), abs(high), 1e-9)
    drawn = [limit for limit in (lower, upper) if abs(limit) <= reach]
    bottom, top = min([low, *drawn]), max([high, *drawn])
    # Next to the limits rounding errors of a joint at rest are not seen.
    widest = max(filter(np.isfinite, (-lower, upper)), default=100.0)
    margin = max(0.09 * (top - bottom), 1e-3 * widest) or 0.1
    panel.set_ylim(bottom - margin, top + margin)
    for limit, edge in zip((lower, upper), panel.get_ylim(), strict=True):
        if limit in drawn:
            _show_limit(panel, limit, edge, "limit", "beyond it")
    named = (("lower", lower), ("upper", upper))
    far = [f"{k} limit {v:.3g}" for k, v in named if np.isfinite(v) and v not in drawn]
    if len(far) == 2:
        both = f"{lower:.3g} and {upper:.3g}"
        far = [f"limits {both}" if lower != -upper else f"limits \u00b1{upper:.3g}"]
    look: dict[str, Any] = {"ha": "right", "va": "bottom", "color": LIMIT_COLOR}
    if far:
        panel.text(1.0, 1.02, far[0], transform=panel.transAxes, fontsize=6.5, **look)


def _plot_joint(
    panel: Axes, shares: Shares, certificate: Certificate, joint: int
) -> None:
    """Draw torque and switching function of a joint."""
    label = f"{shares.control} / limit (left)"
    torque, color = shares.torque[:, joint], figures.color(joint)
    panel.plot(shares.t, torque, color=color, label=label)
    for sign in (-1.0, 1.0):
        _show_limit(panel, sign, 2.0 * sign)
    panel.set_ylim(-BEYOND, BEYOND)
    panel.set_yticks([-1.0, 0.0, 1.0])
    t = certificate.t
    panel.set_ylabel(_in_lines(shares.joint_names[joint]), **_name_look(joint))
    wrong_sides = np.flatnonzero(~certificate.obeys[:, joint])
    spans = [(t[k], t[k + 1] - t[k]) for k in wrong_sides]
    bars = panel.broken_barh(spans, (-2.0, 4.0), color=LIMIT_COLOR, alpha=0.18)
    bars.set(linewidth=0.0, label="sign not obeyed")
    other = panel.twinx()
    other.spines["right"].set_visible(True)
    other.grid(False)
    switching = certificate.switching[:, joint]
    look = SWITCHING_LOOK | {"label": "switching function (right, reversed)"}
    other.stairs(switching, t, baseline=None, **look)
    largest = float(np.max(np.abs(switching), initial=1e-3))
    # Reversed, as the torque is at its upper limit where the function is negative.
    other.set_ylim(BEYOND * largest, -BEYOND * largest)
    other.tick_params(labelsize=7.0, labelbottom=False)


def _limits_shown(
    active: Sequence[ActiveLimit], names: Sequence[str]
) -> list[tuple[ActiveLimit, str]]:
    """Active limits with their colours, the lowest bar first, joints at the top."""
    joints = [item for item in active if item.name in names]
    pairs = [item for item in active if item.name not in names]
    pairs.sort(key=lambda item: -float(item.multiplier.max()))
    joints.sort(key=lambda item: (item.kind, names.index(item.name)))
    shown = [(item, figures.color(names.index(item.name))) for item in joints]
    shown += [(item, LIMIT_COLOR) for item in pairs[:MOST_PAIRS]]
    return shown[::-1]


def _plot_limits(panel: Axes, limits: Sequence[tuple[ActiveLimit, str]]) -> None:
    """Draw bars over the times of active limits, darker for larger multipliers."""
    labels = []
    for row, (item, shade) in enumerate(limits):
        strengths = 0.25 + 0.75 * item.multiplier / item.multiplier.max()
        for begin, end, strength in zip(item.begin, item.end, strengths, strict=True):
            look: dict[str, Any] = {"color": shade, "alpha": strength, "linewidth": 0.0}
            panel.broken_barh([(begin, end - begin)], (row - 0.36, 0.72), **look)
        named = names_subject(item.kind, item.name)
        labels.append(item.kind + ("" if named else f", {_short(item.name, 30)}"))
    labels = labels or ["no limit holds the motion"]
    panel.set_yticks(range(len(labels)), labels, fontsize=6.5)
    panel.set_ylim(-0.6, len(labels) - 0.4)
    panel.grid(False, axis="y")
