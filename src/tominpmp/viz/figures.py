"""Figures: style, legends and files.

matplotlib is imported inside the functions. Figures are drawn without pyplot, so that
no window opens, no global figure is left and no setting of the caller is changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.description.paths import checked_ending, write_file
from tominpmp.exceptions import optional
from tominpmp.notebook import COLORS, LIMIT_COLOR

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEYOND_COLOR = "#f6e3e1"
LIMIT_LOOK: Any = {"color": LIMIT_COLOR, "linewidth": 0.8, "linestyle": "--"}

# The colours of notebooks, and further ones for arms of many joints.
PALETTE = (
    *COLORS,
    "#8c564b",
    "#2f6f4f",
    "#a2142f",
    "#17becf",
    "#7f7f7f",
    "#bcbd22",
    "#1f2d5c",
)

# Widths in a legend [in]: of a letter, and of handle and gap of a label.
LETTER, LEGEND_GAP = 0.046, 0.56


def color(index: int) -> str:
    """Colour of a joint or method by its number."""
    return PALETTE[index % len(PALETTE)]


@contextmanager
def styled() -> Iterator[None]:
    """Context manager that applies the style of figures.mplstyle.

    Raises:
        MissingDependency: If matplotlib is not installed.
    """
    with optional("matplotlib", "plots", "plotting"):
        from matplotlib import style
    # Settings that figures.mplstyle does not name keep the caller's values.
    with style.context(f"{__package__}.figures"):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Make a figure without a window; width and height in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(figure: Figure, path: str | Path | None) -> Figure:
    """Write a figure, if there is a path, and return it.

    Args:
        figure: The figure.
        path: File to write, with the format by its ending; None to write no file.

    Raises:
        ProblemError: If the ending is unknown.
        ScenarioError: If the file cannot be written.
    """
    if path is None:
        return figure
    known = [f".{kind}" for kind in sorted(figure.canvas.get_supported_filetypes())]
    kind = checked_ending(path, known, "figures are not written as").removeprefix(".")
    # Without a date the same motion gives the same file.
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    write_file(path, lambda file: figure.savefig(file, format=kind, metadata=undated))
    return figure


def add_legend(figure: Figure, columns: int) -> None:
    """Put one legend above all panels, in as many columns as the width allows.

    It shows the first line or area of each label; without labels there is no legend.

    Args:
        figure: The figure.
        columns: Largest number of columns.
    """
    keys: dict[str, Any] = {}
    for panel in figure.axes:
        for key, label in zip(*panel.get_legend_handles_labels(), strict=True):
            keys.setdefault(str(label), key)
    if not keys:
        return
    labels = list(keys)
    width = figure.get_figwidth()
    count = min(columns, len(labels))
    while count > 1 and _legend_width(labels, count) > width:
        count -= 1
    # As few columns as fill the same number of rows.
    count = -(-len(labels) // -(-len(labels) // count))
    figure.legend(
        handles=list(keys.values()),
        loc="outside upper center",
        ncols=count,
        handlelength=1.8,
        columnspacing=1.4,
    )


def _legend_width(labels: Sequence[str], columns: int) -> float:
    """Estimated width of a legend [in], which fills one column after the other."""
    parts = np.array_split([len(label) for label in labels], columns)
    return sum(LETTER * int(part.max()) + LEGEND_GAP for part in parts)
