"""Readouts next to the robot: numbers, bars and curves, as HTML and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from os.path import commonprefix

import numpy as np

from tominpmp.app.planning import LEAST_GAIN, BindingLimit, Outcome, ShownMotion
from tominpmp.arrays import Array
from tominpmp.bounds.result import USELESS
from tominpmp.motion.measures import SATURATED
from tominpmp.viz.shares import SPEED_COLOR, TORQUE_COLOR

HOT = "#e11d48"
INK, FAINT, TRACK = "#1f2937", "#6b7280", "#e5e7eb"
GOOD, BAD = "#15803d", "#be123c"
FONT = "font-family:Inter,system-ui,sans-serif"
CUT = "overflow:hidden;text-overflow:ellipsis;white-space:nowrap"
# Height of a curve [px], and number of its points.
HEIGHT, POINTS = 26, 121


def short_names(names: Sequence[str]) -> list[str]:
    """Names of joints without their common prefix, which ends at an underscore."""
    cut = commonprefix(names).rfind("_") + 1 if len(names) > 1 else 0  # noqa: RUF071
    return [name[cut:].removesuffix("_joint") for name in names]


def headline(outcome: Outcome | None, busy: bool, goes_on: bool = False) -> str:
    """HTML of T, its distance from the lower bound, and the result of the replay."""
    if outcome is None:
        return _box(_line("Planning the first motion ...", FAINT))
    shown = outcome.shown
    if shown is None:
        more = _line("The last motion continues to play.", FAINT)
        lines = _line("No motion", BAD, 22) + _line(escape(outcome.message), INK)
        return _box(lines, more if goes_on else "")
    state = "verified by replay" if shown.verified else "not verified"
    look = f"font-size:11px;color:#fff;background:{FAINT if busy else GOOD}"
    look += ";border-radius:9px;padding:1px 8px;white-space:nowrap"
    tag = _span(look, "planning ..." if busy else state)
    large = f"font-size:34px;font-weight:650;color:{INK};white-space:nowrap"
    figures = _span(large, f"{shown.T:.3f} s", ' id="tominpmp-T"')
    near = "" if shown.bound is None else shown.bound.comparison(shown.T)
    if shown.bound is not None and near:
        near += f", {shown.bound.T:.3f}\N{NO-BREAK SPACE}s"
    return _box(
        _div(
            "display:flex;flex-wrap:wrap;align-items:baseline;gap:0 10px", figures, tag
        ),
        _line(near or USELESS, FAINT),
        _line(f"planned in {shown.seconds:.2f} s", FAINT),
    )


def bars(shown: ShownMotion, time: float) -> str:
    """Speed and torque of each joint at a time, as bars against their limits."""
    row = shown.row(time)
    drawn = ((shown.speed, SPEED_COLOR), (shown.torque, TORQUE_COLOR))
    cells = ["<span></span>"]
    for word, (_, color) in zip(("speed", shown.control), drawn, strict=True):
        cells.append(_span(f"color:{color};font-weight:600", word))
    for joint, name in enumerate(short_names(shown.joint_names)):
        cells.append(_span(CUT, escape(name), f' title="{escape(name)}"'))
        cells += [_bar(float(values[row, joint]), color) for values, color in drawn]
    return _grid("86px 1fr 1fr;gap:4px 10px", cells)


def _bar(share: float, color: str) -> str:
    """A bar from the middle to the left or right; its full length is the limit."""
    length = 50.0 * min(abs(share), 1.0)
    begin = 50.0 if share >= 0.0 else 50.0 - length
    color = HOT if abs(share) >= SATURATED else color
    full = f"position:absolute;left:{begin:.1f}%;width:{length:.1f}%;top:0;bottom:0"
    middle = "position:absolute;left:calc(50% - .5px);width:1px;top:0;bottom:0"
    return _div(
        "position:relative;height:10px;border-radius:5px;"
        f"background:{TRACK};overflow:hidden",
        _div(f"{full};background:{color}"),
        _div(f"{middle};background:#9ca3af"),
    )


def curves(shown: ShownMotion) -> str:
    """Speed and torque of each joint over time; red where they are at their limits."""
    rows = np.linspace(0, shown.t.size - 1, POINTS).round().astype(int)
    cells = []
    for joint, name in enumerate(short_names(shown.joint_names)):
        cells.append(_span(CUT, escape(name)))
        cells.append(
            f'<svg viewBox="0 -1.15 {POINTS - 1} 2.3" preserveAspectRatio="none" '
            f'style="width:100%;height:{HEIGHT}px;background:#f9fafb;border-radius:4px">'
            f'<path d="M0 -1H{POINTS}M0 1H{POINTS}" stroke="#d1d5db" fill="none" '
            'stroke-width="1" vector-effect="non-scaling-stroke"/>'
            f"{_curve(shown.torque[rows, joint], TORQUE_COLOR)}"
            f"{_curve(shown.speed[rows, joint], SPEED_COLOR)}</svg>"
        )
    return _grid("86px 1fr;gap:3px 10px", cells)


def _curve(shares: Array, color: str) -> str:
    """A curve of shares, with its saturated parts drawn over it in red."""
    y = np.clip(-shares, -1.1, 1.1).tolist()
    points = [f"{x} {value:.3f}" for x, value in enumerate(y)]
    at = np.abs(shares) >= SATURATED
    edges = np.flatnonzero(np.diff(at.astype(int), prepend=0, append=0))
    runs = [points[i:k] for i, k in edges.reshape(-1, 2).tolist() if k > i + 1]
    line, *hot = ("M" + "L".join(run) for run in (points, *runs))
    style = 'fill="none" stroke-linejoin="round" vector-effect="non-scaling-stroke"'
    drawn = f'<path d="{line}" stroke="{color}" stroke-width="1.6" {style}/>'
    if hot:
        drawn += f'<path d="{"".join(hot)}" stroke="{HOT}" stroke-width="2.4" {style}/>'
    return drawn


def active_limits(limits: Sequence[BindingLimit], optimality: str) -> str:
    """HTML of the active limits: share of the time, and gain of one percent more."""
    if not limits:
        return _box(_line("nothing is at its limit for long", FAINT))
    small = f"font-size:11px;color:{FAINT}"
    head = "display:flex;font-size:12px;justify-content:space-between;gap:8px"
    track = "height:5px;border-radius:3px;background"
    rows = []
    for item in limits:
        percent, gain = 100.0 * item.share, ""
        if item.gain is not None and item.gain >= LEAST_GAIN:
            gain = f"1 % more: {item.gain:.2f} % less time"
        time = f"{percent:.0f} % of the time"
        moment = _span(f"color:{FAINT};white-space:nowrap", time)
        rows.append(
            _div(
                "margin:3px 0",
                _div(f"{head};color:{INK}", _span(CUT, escape(item.name)), moment),
                _div(f"{track}:{TRACK}", _div(f"{track}:{HOT};width:{percent:.1f}%")),
                _div(small, gain),
            )
        )
    if optimality:
        summary = "<summary>How far from the optimum?</summary>"
        rows.append(f'<details style="{small}">{summary}{escape(optimality)}</details>')
    return _box(*rows)


def notice(text: str, *, bad: bool) -> str:
    """HTML of a notice for the user."""
    color = BAD if bad else FAINT
    look = f"font-size:12px;color:{color};border-left:3px solid {color}"
    return text and _box(
        _div(f"{look};padding-left:8px;overflow-wrap:anywhere", escape(text))
    )


def _line(text: str, color: str, size: int = 13) -> str:
    return _div(f"font-size:{size}px;color:{color}", text)


def _grid(columns: str, cells: Sequence[str]) -> str:
    look = f"display:grid;grid-template-columns:{columns};font-size:12px"
    return _box(_div(f"{look};align-items:center;color:{INK}", *cells))


def _box(*inside: str) -> str:
    return _div(f"{FONT};padding:2px 12px 4px 12px", *inside)


def _div(look: str, *inside: str) -> str:
    return f'<div style="{look}">{"".join(inside)}</div>'


def _span(look: str, text: str, attributes: str = "") -> str:
    return f'<span style="{look}"{attributes}>{text}</span>'
