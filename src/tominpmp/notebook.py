"""Representations of objects: small plots (SVG) and tables (HTML, or plain text).

The module writes text only, and needs no plotting library; names are escaped, as they
may come from untrusted files.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import brief, shortened

# Okabe and Ito's colours, which are distinguishable with colour blindness.
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#5b4b8a")
GREY, LIMIT_COLOR = "#9aa5b1", "#b3312a"
WIDTH, HEIGHT, EDGE = 240.0, 110.0, 6.0
TEXT = "font:11px sans-serif;fill:#4a5867"
# Longest table; robots may have hundreds of joints. Longest text in a cell, and the
# width at which it continues on another line.
MOST_ROWS, LONGEST = 40, 600
CELL = "max-width:30em;overflow-wrap:anywhere"


def table(
    head: Sequence[str], rows: Sequence[Sequence[object]], *, joints: bool = False
) -> str:
    """A table; numbers are rounded, surplus rows and ends of texts are left out.

    Args:
        head: Titles of the columns; empty for a table without a head.
        rows: The rows.
        joints: Whether each row describes a joint, and begins with the colour of its
            curve.
    """
    titles = [*([""] if joints else []), *head]
    cells = "".join(f"<th>{escape(name)}</th>" for name in titles)
    lines = [f"<tr>{cells}</tr>"] if head else []
    for number, row in enumerate(rows[:MOST_ROWS]):
        cells = "".join(f'<td style="{CELL}">{escape(_text(x))}</td>' for x in row)
        color = COLORS[number % len(COLORS)]
        mark = f'<td style="color:{color}">&#9632;</td>' if joints else ""
        lines.append(f"<tr>{mark}{cells}</tr>")
    if len(rows) > MOST_ROWS:
        lines.append(f"<tr><td>and {len(rows) - MOST_ROWS} more</td></tr>")
    return f"<table>{''.join(lines)}</table>"


def text_table(rows: Sequence[Sequence[str]], left: int) -> str:
    """A table in plain text, with two spaces between its columns.

    Args:
        rows: The cells of each row; the titles come first.
        left: Number of columns, from the first, that are aligned on the left.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        pairs = list(zip(row, widths, strict=True))
        cells = [cell.ljust(width) for cell, width in pairs[:left]]
        cells += [cell.rjust(width) for cell, width in pairs[left:]]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def _text(value: object) -> str:
    if isinstance(value, float | np.floating):
        number = float(value)
        return f"{number if abs(number) > 1e-12 else 0.0:.4g}"
    return shortened(value, LONGEST) if isinstance(value, str) else brief(value)


def curves(title: str, t: Array, values: Array, limits: Sequence[float] = ()) -> str:
    """A panel with one curve per column.

    Args:
        title: Quantity that is drawn, with its unit.
        t: Times, shape (m,).
        values: Shape (m, n); values that are not finite are drawn as zero.
        limits: Values at which horizontal lines are drawn.
    """
    finite = np.where(np.isfinite(values), values, 0.0)
    bounds = [*limits, float(finite.min(initial=0.0)), float(finite.max(initial=0.0))]
    low, high = min(bounds), max(bounds)
    span = (high - low) or 1.0
    x = EDGE + (WIDTH - 2 * EDGE) * (t - t[0]) / ((t[-1] - t[0]) or 1.0)
    y = HEIGHT - EDGE - (HEIGHT - 4 * EDGE) * (finite - low) / span
    marks = [HEIGHT - EDGE - (HEIGHT - 4 * EDGE) * (at - low) / span for at in limits]
    parts = [
        f'<line x1="{EDGE}" x2="{WIDTH - EDGE}" y1="{at:.1f}" y2="{at:.1f}" '
        f'stroke="{LIMIT_COLOR}" stroke-dasharray="4 3"/>'
        for at in marks
    ]
    parts += [
        _line(np.stack([x, y[:, i]], axis=1), COLORS[i % len(COLORS)], name=f"{i + 1}")
        for i in range(values.shape[1])
    ]
    return _svg(title, parts)


def skeletons(title: str, arms: Sequence[Array]) -> str:
    """A panel with stick figures.

    Args:
        title: Title of the panel.
        arms: Ends of the sticks of each configuration, shape (k, 2, 3) [m]; the last
            configuration is drawn in colour.
    """
    points = np.concatenate([arm.reshape(-1, 3) for arm in arms])
    flat = np.ptp(points[:, 2]) < 1e-6
    axes = [0, 1] if flat else [int(np.argmax(np.ptp(points[:, :2], axis=0))), 2]
    seen = points[:, axes]
    low, extent = seen.min(axis=0), max(float(np.ptp(seen, axis=0).max()), 1e-6)
    scale = (HEIGHT - 4 * EDGE) / extent
    parts = []
    for number, arm in enumerate(arms, 1):
        ends = (arm[:, :, axes] - low) * scale
        ends = np.stack([2 * EDGE + ends[..., 0], HEIGHT - EDGE - ends[..., 1]], axis=2)
        color = COLORS[0] if number == len(arms) else GREY
        parts += [_line(stick, color, width=3.0) for stick in ends]
    return _svg(title, parts)


def card(title: str, *parts: str) -> str:
    """Plots and tables below a title."""
    style = "padding:2px 12px 2px 0"
    inside = "".join(f'<div style="{style}">{part}</div>' for part in parts)
    return (
        f'<div><b>{escape(title)}</b><div style="display:flex;flex-wrap:wrap">'
        f"{inside}</div></div>"
    )


def motion_card(
    title: str, names: Sequence[str], t: Array, q: Array, v: Array, u: Array
) -> str:
    """Curves of a motion, shape (m, n) each, and a table with one row per joint."""
    rates = {"v": v} if np.all(np.isnan(u)) else {"v": v, "u": u}
    panels = [curves(name, t, x) for name, x in {"q": q, **rates}.items()]
    largest = (np.abs(x).max(axis=0).tolist() for x in rates.values())
    columns = names, q[0].tolist(), q[-1].tolist(), *largest
    head = ("joint", "start", "end", *(f"max |{name}|" for name in rates))
    rows = table(head, list(zip(*columns, strict=True)), joints=True)
    return card(title, *panels, rows)


def _line(points: Array, color: str, width: float = 1.4, name: str = "") -> str:
    where = " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())
    label = f"<title>{escape(name)}</title>" if name else ""
    return (
        f'<polyline points="{where}" fill="none" stroke="{color}" '
        f'stroke-width="{width}" stroke-linecap="round">{label}</polyline>'
    )


def _svg(title: str, parts: Sequence[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH:g}" '
        f'height="{HEIGHT:g}" role="img" aria-label="{escape(title)}">'
        f'<text x="{EDGE}" y="12" style="{TEXT}">{escape(title)}</text>'
        f"{''.join(parts)}</svg>"
    )
