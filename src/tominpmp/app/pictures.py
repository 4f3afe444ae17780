"""What the page draws beside the robot: numbers, bars and curves, as HTML and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from tominpmp.app.planning import Held, Outcome, Shown
from tominpmp.arrays import Array
from tominpmp.bounds.result import USELESS
from tominpmp.viz.shares import AT_LIMIT, SPEED_COLOR, TORQUE_COLOR

HOT = "#e11d48"
INK, FAINT, TRACK = "#1f2937", "#6b7280", "#e5e7eb"
GOOD, BAD = "#15803d", "#be123c"
FONT = "font-family:Inter,system-ui,sans-serif"
# Size of a curve [px], and of the points in it.
WIDTH, HEIGHT, POINTS = 320, 26, 121


def short_names(names: Sequence[str]) -> list[str]:
    """Names of joints without what all of them begin with, where that leaves enough."""
    if len(names) < 2:
        return list(names)
    same = 0
    while all(len(n) > same + 1 and n[same] == names[0][same] for n in names):
        same += 1
    cut = names[0].rfind("_", 0, same) + 1
    return [name[cut:].removesuffix("_joint") for name in names]


def headline(outcome: Outcome | None, busy: bool, goes_on: bool = False) -> str:
    """T in large figures, how near it is to what is possible, and how it was judged."""
    if outcome is None:
        return _box(_line("Planning the first motion ...", FAINT))
    shown = outcome.shown
    if shown is None:
        more = _line("The last motion that was found goes on.", FAINT)
        told = _line("No motion", BAD, 22) + _line(escape(outcome.message), INK)
        return _box(told + (more if goes_on else ""))
    state = "verified by replay" if shown.verified else "not verified"
    tag = _tag("planning ..." if busy else state, FAINT if busy else GOOD)
    rows = [
        f'<div style="display:flex;align-items:baseline;gap:10px">'
        f'<span style="font-size:34px;font-weight:650;color:{INK}" id="tominpmp-T">'
        f"{shown.T:.3f} s</span>{tag}</div>"
    ]
    near = "" if shown.bound is None else shown.bound.comparison(shown.T)
    if shown.bound is not None and near:
        near += f", {shown.bound.T:.3f} s"
    rows.append(_line(near or USELESS, FAINT))
    rows.append(_line(f"planned in {shown.seconds:.2f} s", FAINT))
    return _box("".join(rows))


def bars(shown: Shown, time: float) -> str:
    """Speed and torque of each joint at a time, as bars against their limits."""
    row = shown.row(time)
    names = short_names(shown.joint_names)
    head = (
        '<div style="display:grid;grid-template-columns:76px 1fr 1fr;gap:4px 10px;'
        f'font-size:12px;align-items:center;color:{INK}">'
        f'<span></span><span style="color:{SPEED_COLOR};font-weight:600">speed</span>'
        f'<span style="color:{TORQUE_COLOR};font-weight:600">torque</span>'
    )
    cells = []
    for joint, name in enumerate(names):
        cells.append(
            f'<span style="{_CUT}" title="{escape(name)}">{escape(name)}</span>'
        )
        cells.append(_bar(float(shown.speed[row, joint]), SPEED_COLOR))
        cells.append(_bar(float(shown.torque[row, joint]), TORQUE_COLOR))
    return _box(head + "".join(cells) + "</div>")


_CUT = "overflow:hidden;text-overflow:ellipsis;white-space:nowrap"


def _bar(share: float, color: str) -> str:
    """A bar from the middle to the left or right; full where the limit is."""
    length = 50.0 * min(abs(share), 1.0)
    begin = 50.0 if share >= 0.0 else 50.0 - length
    color = HOT if abs(share) >= AT_LIMIT else color
    return (
        f'<div style="position:relative;height:10px;border-radius:5px;'
        f"background:{TRACK};"
        f'overflow:hidden"><div style="position:absolute;left:{begin:.1f}%;'
        f'width:{length:.1f}%;top:0;bottom:0;background:{color}"></div>'
        f'<div style="position:absolute;left:calc(50% - .5px);width:1px;top:0;bottom:0;'
        f'background:#9ca3af"></div></div>'
    )


def curves(shown: Shown) -> str:
    """Speed and torque of each joint over time; red where they are at their limits."""
    names = short_names(shown.joint_names)
    rows = np.linspace(0, shown.t.size - 1, POINTS).round().astype(int)
    parts = []
    for joint, name in enumerate(names):
        drawn = _curve(shown.torque[rows, joint], TORQUE_COLOR)
        drawn += _curve(shown.speed[rows, joint], SPEED_COLOR)
        parts.append(
            f'<span style="{_CUT}">{escape(name)}</span>'
            f'<svg viewBox="0 -1.15 {POINTS - 1} 2.3" preserveAspectRatio="none" '
            f'style="width:100%;height:{HEIGHT}px;background:#f9fafb;border-radius:4px">'
            f'<path d="M0 -1H{POINTS}M0 1H{POINTS}" stroke="#d1d5db" fill="none" '
            f'stroke-width="1" vector-effect="non-scaling-stroke"/>{drawn}</svg>'
        )
    return _box(
        '<div style="display:grid;grid-template-columns:76px 1fr;gap:3px 10px;'
        f'font-size:12px;align-items:center;color:{INK}">{"".join(parts)}</div>'
    )


def _curve(shares: Array, color: str) -> str:
    """A curve of shares, and over it once more what is at the limit."""
    y = np.clip(-shares, -1.1, 1.1)
    line = "M" + "L".join(f"{x} {value:.3f}" for x, value in enumerate(y.tolist()))
    hot, at = [], np.abs(shares) >= AT_LIMIT
    edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2).tolist():
        points = [f"{x} {y[x]:.3f}" for x in range(begin, end)]
        if len(points) > 1:
            hot.append("M" + "L".join(points))
    style = 'fill="none" stroke-linejoin="round" vector-effect="non-scaling-stroke"'
    drawn = f'<path d="{line}" stroke="{color}" stroke-width="1.6" {style}/>'
    if hot:
        drawn += f'<path d="{"".join(hot)}" stroke="{HOT}" stroke-width="2.4" {style}/>'
    return drawn


def held_back(held: Sequence[Held], optimality: str) -> str:
    """What holds the motion back: for how long, and what more of it would give."""
    if not held:
        return _box(_line("nothing is at its limit for long", FAINT))
    rows = []
    for item in held:
        gain = ""
        if item.gain is not None and item.gain >= 0.005:
            gain = f"1 % more: {item.gain:.2f} % less time"
        rows.append(
            f'<div style="margin:3px 0"><div style="display:flex;font-size:12px;'
            f'justify-content:space-between;gap:8px;color:{INK}">'
            f'<span style="{_CUT}">{escape(item.what)}</span>'
            f'<span style="color:{FAINT};white-space:nowrap">'
            f"{100.0 * item.share:.0f} % of the time</span></div>"
            f'<div style="height:5px;border-radius:3px;background:{TRACK}">'
            f'<div style="height:5px;border-radius:3px;background:{HOT};'
            f'width:{100.0 * item.share:.1f}%"></div></div>'
            f'<div style="font-size:11px;color:{FAINT}">{gain}</div></div>'
        )
    told = f'<details style="font-size:11px;color:{FAINT}"><summary>How far from the '
    told += f"optimum?</summary>{escape(optimality)}</details>" if optimality else ""
    return _box("".join(rows) + (told if optimality else ""))


def notice(text: str, *, bad: bool = False) -> str:
    """A sentence for the one who drags."""
    if not text:
        return ""
    color = BAD if bad else FAINT
    return _box(
        f'<div style="font-size:12px;color:{color};border-left:3px solid {color};'
        f'padding-left:8px;overflow-wrap:anywhere">{escape(text)}</div>'
    )


def _line(text: str, color: str, size: int = 13) -> str:
    return f'<div style="font-size:{size}px;color:{color}">{text}</div>'


def _tag(text: str, color: str) -> str:
    return (
        f'<span style="font-size:11px;color:#fff;background:{color};border-radius:9px;'
        f'padding:1px 8px">{text}</span>'
    )


def _box(inside: str) -> str:
    return f'<div style="{FONT};padding:2px 12px 4px 12px">{inside}</div>'
