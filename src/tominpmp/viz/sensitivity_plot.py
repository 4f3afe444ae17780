"""Bars of what holds a motion back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.checks import instance, whole
from tominpmp.sensitivities.records import (
    LEAST,
    Sensitivities,
    Sensitivity,
)
from tominpmp.viz.figures import color, finish, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Heights in inches: of a bar, and of what is around them.
BAR, REST = 0.24, 1.0
FASTER, SLOWER = 2, 1


def plot_sensitivities(
    sensitivities: Sensitivities, path: str | Path | None = None, *, most: int = 20
) -> Figure:
    """Draw by how much T changes with one per cent, or a millimetre, of each limit.

    Args:
        sensitivities: What to draw.
        path: File to write (PNG, PDF or SVG by its ending), if any.
        most: Largest number of bars.

    Raises:
        ProblemError: If the ending of the path is unknown, or the number is none.
        ScenarioError: If the file cannot be written.
        MissingDependency: If matplotlib is not installed.
    """
    instance(sensitivities, Sensitivities, "sensitivities", "Sensitivities of a motion")
    most = whole(most, "most", least=1, expected="a number of bars >= 1")
    shown = [item for item in sensitivities if abs(item.effect) >= LEAST][:most]
    with styled():
        figure = new_figure(7.0, max(len(shown), 1) * BAR + REST)
        panel = figure.subplots()
        effects = np.array([100.0 * item.effect for item in shown])
        places = np.arange(len(shown))
        colors = [color(FASTER if x < 0.0 else SLOWER) for x in effects.tolist()]
        panel.barh(places, effects, color=colors, height=0.7)
        panel.axvline(0.0, color="#4a5867", linewidth=0.7)
        panel.set_yticks(places, [_label(item) for item in shown])
        panel.set_ylim(max(len(shown), 1) - 0.4, -0.6)
        panel.grid(False, axis="y")
        panel.set_xlabel("change of T [%]")
        panel.set_title(f"what holds T = {sensitivities.T:.4g} s", loc="left")
        return finish(figure, path)


def _label(item: Sensitivity) -> str:
    return f"{item.label}  +{item.more}"
