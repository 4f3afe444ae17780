"""The figures of the demo that compare methods: torques and convergence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from motion_samples import planar_motions
from record_samples import record

import tominpmp as tm
from examples import paper_demo
from tominpmp.viz import figures
from tominpmp.viz.plots import curve_states


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Collects the figures that are written."""
    written, finish = list[Figure](), figures.finish

    def recorded(figure: Figure, path: Any) -> Figure:
        written.append(finish(figure, path))
        return figure

    monkeypatch.setattr(figures, "finish", recorded)
    return written


def points(line: Any) -> np.ndarray:
    return np.column_stack([line.get_xdata(), line.get_ydata()])


def legend_texts(figure: Figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_motion_figure_shows_the_arm_at_instants(
    drawn: list[Figure], tmp_path: Path
) -> None:
    problem, held, braked = planar_motions()
    path = tmp_path / "motion.png"
    paper_demo.plot_motions(problem, {"a": held, "b": braked}, path)
    (figure,) = drawn
    for panel, motion in zip(figure.axes, (held, braked), strict=True):
        arms = [line for line in panel.get_lines() if line.get_marker() == "o"]
        assert len(arms) == paper_demo.INSTANTS
        angles = np.cumsum(motion(np.linspace(0.0, motion.duration, 15)).q, axis=1)
        for line, angle in zip(arms, angles, strict=True):
            links = np.column_stack([np.cos(angle), np.sin(angle)])
            ends = np.cumsum([[3.0], [2.0], [1.0]] * links, axis=0)
            np.testing.assert_allclose(points(line)[2:], ends, atol=1e-12)
        alphas = [line.get_alpha() for line in arms]
        assert alphas == sorted(alphas)
        (circle,) = panel.patches
        assert circle.get_radius() == 0.8
    assert figure.axes[1].get_title("left") == "b: T = 0.95 s"
    assert "obstacle" in legend_texts(figure)


def test_controls_figure_overlays_the_torques_of_motions(
    drawn: list[Figure], tmp_path: Path
) -> None:
    problem, held, braked = planar_motions()
    path = tmp_path / "controls.png"
    paper_demo.plot_controls(problem, {"initial": held, "adjoint": braked}, path)
    (figure,) = drawn
    assert path.read_bytes().startswith(b"\x89PNG")
    assert len(figure.axes) == 3
    for i, panel in enumerate(figure.axes):
        first, second, *limits = panel.get_lines()
        for curve, motion in ((first, held), (second, braked)):
            torques = curve_states(motion)[1].u[:, i]
            np.testing.assert_array_equal(points(curve)[:, 1], torques)
        assert first.get_color() != second.get_color()
        effort = problem.robot.limits.effort_upper[i]
        assert [line.get_ydata()[0] for line in limits] == [-effort, effort]
        assert panel.get_xlim() == (0.0, 1.1)
        assert panel.get_ylabel() == f"u{i + 1} [N m]"
        assert panel.get_title("left") == held.joint_names[i]
    labels = ["initial (T = 1.1 s)", "adjoint (T = 0.95 s)", "limit"]
    assert legend_texts(figure) == labels


def records(durations: Sequence[float]) -> list[tm.IterationRecord]:
    return [
        record(
            i,
            duration=duration,
            violation=0.0 if i == len(durations) - 1 else 10.0**-i,
            seconds=0.1 * i,
        )
        for i, duration in enumerate(durations)
    ]


def test_convergence_figure_has_duration_and_violation_of_methods(
    drawn: list[Figure], tmp_path: Path
) -> None:
    history: Mapping[str, list[tm.IterationRecord]] = {
        "adjoint": records([1.5, 1.2, 1.0, 0.9]),
        # The iteration numbers restart with the second part of the descent.
        "penalty": records([1.4, 0.9]) + records([1.3, 1.1, 1.0]),
    }
    path = tmp_path / "convergence.svg"
    paper_demo.plot_convergence(history, path)
    above, below = (figure := drawn[0]).axes
    assert below.get_yscale() == "log"
    assert above.get_ylabel() == "T [s]"
    assert [points(line).tolist() for line in above.get_lines()] == [
        [[0.0, 1.5], [1.0, 1.2], [2.0, 1.0], [3.0, 0.9]],
        [[0.0, 1.4], [1.0, 0.9], [2.0, 1.3], [3.0, 1.1], [4.0, 1.0]],
    ]
    # Zero has no logarithm.
    violation = points(below.get_lines()[0])[:, 1]
    least = paper_demo.LEAST_VIOLATION
    np.testing.assert_allclose(violation, [1.0, 0.1, 0.01, least])
    assert legend_texts(figure) == ["adjoint", "penalty"]
    assert "mathdefault" not in path.read_text("utf-8")


def test_convergence_figure_shows_short_beside_long_histories(
    drawn: list[Figure], tmp_path: Path
) -> None:
    history = {"inverse": records([1.0] * 8), "penalty": records([1.0] * 300)}
    paper_demo.plot_convergence(history, tmp_path / "convergence.png")
    below = drawn[0].axes[1]
    assert below.get_xscale() == "symlog"
    axis = below.transData.transform([(0.0, 1.0), (8.0, 1.0), (300.0, 1.0)])[:, 0]
    assert (axis[1] - axis[0]) / (axis[2] - axis[0]) > 0.2
