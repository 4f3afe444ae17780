"""Plot of a certificate: torques, switching functions, active limits, Hamiltonian."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.certificate.certificate import ActiveLimit, Certificate
from tominpmp.checks import instance
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.viz.figures import (
    LIMIT_COLOR,
    add_legend,
    area_key,
    color,
    finish,
    line_key,
    name_size,
    new_figure,
    note,
    show_limit,
    styled,
    time_axes,
)
from tominpmp.viz.plots import curves
from tominpmp.viz.skeleton import check_motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SWITCHING_COLOR = "#2b3440"
HAMILTONIAN_COLOR = "#5b4b8a"
# Heights in inches: of a joint, of a bar, of the Hamiltonian, of what is around them.
JOINT, BAR, HAMILTONIAN, REST = 0.95, 0.2, 1.0, 1.3
# Torques are drawn up to this share beyond their limits.
BEYOND = 1.12
# Pairs of links with the largest multipliers are shown, no more of them.
MOST_PAIRS = 8


def plot_certificate(
    problem: Problem,
    trajectory: Trajectory,
    certificate: Certificate,
    path: str | Path | None = None,
) -> Figure:
    """Plot what a certificate says over time.

    For each joint there is the torque in shares of its limits, and its switching
    function on a reversed axis, so that the torque of an optimal motion is at the
    limit on whose side the switching function is. Below are the limits that hold the
    motion, and the Hamiltonian.

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
    check_motion(problem, trajectory)
    instance(certificate, Certificate, "certificate")
    robot, n = problem.robot, problem.robot.n
    limits = _shown(certificate.active, robot.joint_names)
    bars = max(len(limits), 1) * BAR + 0.15
    heights = [*[JOINT] * n, bars, HAMILTONIAN]
    with styled():
        figure = new_figure(9.0, sum(heights) + REST)
        axes = figure.subplots(n + 2, 1, squeeze=False, height_ratios=heights)[:, 0]
        for joint in range(n):
            _plot_joint(axes[joint], problem, trajectory, certificate, joint)
        _plot_limits(axes[n], limits, robot.joint_names)
        _plot_hamiltonian(axes[n + 1], certificate)
        for panel in axes[:-1]:
            panel.tick_params(labelbottom=False)
        time_axes(axes[:, None], trajectory.duration)
        axes[0].set_title(_headline(certificate), loc="left")
        add_legend(figure, _handles(), 4)
        return finish(figure, path)


def _headline(certificate: Certificate) -> str:
    """The figures in a line."""
    kept = "kept" if certificate.ok else "NOT kept"
    return (
        f"first-order conditions {kept}: "
        f"small changes promise {100 * certificate.stationarity:.2g} % of T, "
        f"signs obeyed {100 * certificate.sign_share:.1f} % of the time"
    )


def _plot_joint(
    panel: Axes,
    problem: Problem,
    trajectory: Trajectory,
    certificate: Certificate,
    joint: int,
) -> None:
    """Torque and switching function of a joint."""
    limits = problem.robot.limits
    lower, upper = limits.effort_lower[joint], limits.effort_upper[joint]
    middle, half = 0.5 * (upper + lower), 0.5 * (upper - lower)
    times, state = curves(trajectory)
    panel.plot(times, (state.u[:, joint] - middle) / (half or 1.0), color=color(joint))
    for sign in (-1.0, 1.0):
        show_limit(panel, sign, 2.0 * sign)
    panel.set_ylim(-BEYOND, BEYOND)
    panel.set_yticks([-1.0, 0.0, 1.0])
    name = problem.robot.joint_names[joint]
    look: dict[str, Any] = {"color": color(joint), "fontweight": "bold"}
    panel.set_ylabel(name, fontsize=name_size(name), **look)
    _shade(panel, certificate.t, ~certificate.obeys[:, joint])
    other = panel.twinx()
    other.spines["right"].set_visible(True)
    other.grid(False)
    switching = certificate.switching[:, joint]
    other.stairs(
        switching,
        certificate.t,
        baseline=None,
        color=SWITCHING_COLOR,
        linewidth=0.9,
    )
    largest = float(np.max(np.abs(switching), initial=1e-3))
    # Reversed: a negative switching function asks for the upper limit.
    other.set_ylim(BEYOND * largest, -BEYOND * largest)
    other.tick_params(labelsize=7.0, labelbottom=False)


def _shade(panel: Axes, t: Array, where: BoolArray) -> None:
    """Shade the intervals on which something holds."""
    spans = [(t[k], t[k + 1] - t[k]) for k in np.flatnonzero(where)]
    if spans:
        panel.broken_barh(
            spans, (-2.0, 4.0), color=LIMIT_COLOR, alpha=0.18, linewidth=0.0
        )


def _shown(
    active: Sequence[ActiveLimit], names: Sequence[str]
) -> list[tuple[ActiveLimit, int]]:
    """Limits with their joints (-1 for pairs), the lowest bar first."""
    joints = [item for item in active if item.name in names]
    pairs = [item for item in active if item.name not in names]
    pairs.sort(key=lambda item: -float(item.multiplier.max()))
    order = {name: i for i, name in enumerate(names)}
    joints.sort(key=lambda item: (item.kind, order[item.name]))
    shown = [(item, order[item.name]) for item in joints]
    shown += [(item, -1) for item in pairs[:MOST_PAIRS]]
    return shown[::-1]


def _plot_limits(
    panel: Axes, limits: Sequence[tuple[ActiveLimit, int]], names: Sequence[str]
) -> None:
    """Bars over the times at which limits hold, stronger where they cost more."""
    labels = []
    for row, (item, joint) in enumerate(limits):
        largest = float(item.multiplier.max())
        shade = color(joint) if joint >= 0 else LIMIT_COLOR
        for begin, end, value in zip(
            item.begin, item.end, item.multiplier, strict=True
        ):
            panel.broken_barh(
                [(begin, end - begin)],
                (row - 0.36, 0.72),
                color=shade,
                alpha=0.25 + 0.75 * float(value) / largest,
                linewidth=0.0,
            )
        labels.append(f"{item.kind}, {_short(item.name)}")
    panel.set_yticks(range(len(labels)), labels, fontsize=6.5)
    panel.set_ylim(-0.6, max(len(labels), 1) - 0.4)
    panel.grid(False, axis="y")
    if not labels:
        text, look = "no limit holds the motion", {"ha": "center", "va": "center"}
        note(panel, text, (0.5, 0.5), fontsize=7.0, **look)


def _short(name: str, most: int = 30) -> str:
    return name if len(name) <= most else f"{name[: most - 1]}\u2026"


def _plot_hamiltonian(panel: Axes, certificate: Certificate) -> None:
    panel.axhline(0.0, color="#9aa5b1", linewidth=0.8)
    panel.stairs(
        certificate.hamiltonian, certificate.t, baseline=None, color=HAMILTONIAN_COLOR
    )
    largest = max(1.2 * np.max(np.abs(certificate.hamiltonian), initial=0.0), 0.05)
    panel.set_ylim(-largest, largest)
    panel.set_ylabel("H", rotation=0, labelpad=10.0)


def _handles() -> list[Any]:
    look: dict[str, Any] = {"color": SWITCHING_COLOR, "linewidth": 0.9}
    return [
        line_key("torque / limit (left)", color=color(0)),
        line_key("switching function (right, reversed)", **look),
        area_key("sign not obeyed", facecolor=LIMIT_COLOR, alpha=0.18),
        line_key("Hamiltonian H", color=HAMILTONIAN_COLOR),
    ]
