"""Comparison of two runs of the golden set with limits for their differences."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.golden_runner import Row
from benchmarks.sheet import markdown

Name = tuple[str, str]
HEADER = (
    "group",
    "problems",
    "found",
    "T: mean",
    "median",
    "most",
    "least",
    "objective: most",
    "programs: sum",
    "95 %",
    "time: sum",
    "95 %",
    "promise: most",
    "verdicts",
)


@dataclass(frozen=True)
class Allowed:
    """Limits for the second run relative to the first; None for no limit.

    Attributes:
        t_median: Median of the ratio of T, minus one, over all problems.
        t_max: Largest ratio of T, minus one.
        t_group: Largest median of a group.
        objective_max: Largest ratio of the objective, minus one, where it is not T.
        programs: Ratio of the sums of programs.
        programs_95: Ratio of the 95th percentiles of programs.
        seconds: Ratio of the sums of processor time.
        seconds_95: Ratio of the 95th percentiles of processor time.
        promise: Largest rise of the gain predicted by the certificate, as a share of T.
        lost: Number of motions that are no longer found, or refuted now.
        changed: Number of problems that the second run lacks, or has changed.
    """

    t_median: float | None = None
    t_max: float | None = None
    t_group: float | None = None
    objective_max: float | None = None
    programs: float | None = None
    programs_95: float | None = None
    seconds: float | None = None
    seconds_95: float | None = None
    promise: float | None = None
    lost: int | None = 0
    changed: int | None = 0


class Comparison:
    """Problems that are in both runs.

    Args:
        before: Rows of the first run by group and name.
        after: Rows of the second.
    """

    def __init__(self, before: Mapping[Name, Row], after: Mapping[Name, Row]) -> None:
        self.only = sorted(set(before) ^ set(after))
        both = [name for name in before if name in after]
        self.changed = [
            name
            for name in both
            if before[name]["fingerprint"] != after[name]["fingerprint"]
        ]
        self.names = [name for name in both if name not in self.changed]
        self.missing = [name for name in before if name not in self.names]
        self.before, self.after = before, after

    def groups(self) -> list[str]:
        """Groups in the order of the first run."""
        return list(dict.fromkeys(group for group, _ in self.names))

    def chosen(self, group: str | None = None) -> list[Name]:
        """Problems of a group, or all."""
        return [name for name in self.names if group in (None, name[0])]

    def _pair(self, name: Name, column: str) -> tuple[float, float]:
        return _number(self.before[name], column), _number(self.after[name], column)

    def ratios(self, column: str, names: Sequence[Name]) -> dict[Name, float]:
        """Ratio of a column of the second run to the first, where motions are found.

        Args:
            column: Name of the column, such as "T".
            names: Problems.
        """
        pairs = {
            name: self._pair(name, column)
            for name in names
            if good(self.before[name]) and good(self.after[name])
        }
        return {
            name: b / a
            for name, (a, b) in pairs.items()
            if a > 0.0 and math.isfinite(b)
        }

    def work(self, column: str, names: Sequence[Name]) -> tuple[float, float]:
        """Ratios of the sums and of the 95th percentiles over all problems."""
        pairs = [self._pair(name, column) for name in names]
        known = np.array([pair for pair in pairs if all(map(math.isfinite, pair))])
        if not len(known) or not known[:, 0].sum():
            return math.nan, math.nan
        first, second = known.T
        quantiles = np.percentile(known, 95, axis=0)
        share = quantiles[1] / quantiles[0] if quantiles[0] else math.nan
        return float(second.sum() / first.sum()), float(share)

    def promises(self, names: Sequence[Name]) -> dict[Name, float]:
        """Rise of the gain predicted by the certificate, as a share of T."""
        pairs = {name: self._pair(name, "promise") for name in names}
        found = {name: second - first for name, (first, second) in pairs.items()}
        return {name: x for name, x in found.items() if math.isfinite(x)}

    def verdicts(self, names: Sequence[Name]) -> list[str]:
        """Problems with a changed verdict, a line each."""
        lines = []
        for name in names:
            a, b = _verdict(self.before[name]), _verdict(self.after[name])
            if a != b:
                lines.append(f"{name[0]}: {name[1]}: {a} -> {b}")
        return lines

    def lost(self, names: Sequence[Name]) -> list[Name]:
        """Problems whose motion is no longer found, or refuted now."""
        return [n for n in names if good(self.before[n]) and not good(self.after[n])]

    def table(self) -> str:
        """A line for each group, and for all."""
        lines = [self._line(group, self.chosen(group)) for group in self.groups()]
        return markdown(HEADER, [*lines, self._line("all", self.names)])

    def _line(self, group: str, names: Sequence[Name]) -> list[str]:
        found = [
            sum(good(rows[n]) for n in names) for rows in (self.before, self.after)
        ]
        T, other = self.ratios("T", names), self.ratios("objective", names)
        programs, seconds = self.work("programs", names), self.work("seconds", names)
        promises = self.promises(names)
        values = list(T.values())
        return [
            group,
            str(len(names)),
            f"{found[0]} -> {found[1]}",
            _percent(statistics.fmean(values) - 1.0) if values else "-",
            _percent(statistics.median(values) - 1.0) if values else "-",
            _extreme(T, max),
            _extreme(T, min),
            _extreme(other, max),
            *(f"{x:.3f}" for x in (*programs, *seconds)),
            _extreme({k: 1.0 + v for k, v in promises.items()}, max),
            str(len(self.verdicts(names))),
        ]

    def beyond(self, allowed: Allowed) -> list[str]:
        """Differences that exceed their limits, a sentence each."""
        T, other = self.ratios("T", self.names), self.ratios("objective", self.names)
        programs = self.work("programs", self.names)
        seconds = self.work("seconds", self.names)
        promises = list(self.promises(self.names).values())
        values = [x - 1.0 for x in T.values()]
        medians = [
            statistics.median(known) - 1.0
            for group in self.groups()
            if (known := list(self.ratios("T", self.chosen(group)).values()))
        ]
        measured: list[tuple[str, float | None, float | None]] = [
            ("T, median", statistics.median(values or [0.0]), allowed.t_median),
            ("T, most", max(values, default=0.0), allowed.t_max),
            ("T, median of a group", max(medians, default=0.0), allowed.t_group),
            (
                "objective, most",
                max((x - 1.0 for x in other.values()), default=0.0),
                allowed.objective_max,
            ),
            ("programs, sum", programs[0], allowed.programs),
            ("programs, 95 %", programs[1], allowed.programs_95),
            ("processor time, sum", seconds[0], allowed.seconds),
            ("processor time, 95 %", seconds[1], allowed.seconds_95),
            ("promise, most", max(promises, default=0.0), allowed.promise),
            ("motions lost", float(len(self.lost(self.names))), allowed.lost),
            ("problems changed", float(len(self.missing)), allowed.changed),
        ]
        return [
            f"{name}: {value:.6g}, and {most:g} is allowed"
            for name, value, most in measured
            if most is not None and not value <= most
        ]

    def report(self, largest: int = 10) -> str:
        """The table, verdicts that changed, and the largest changes of T.

        Args:
            largest: How many changes of T are named.
        """
        parts = [self.table()]
        for title, lines in (
            ("Only one run has", [": ".join(name) for name in self.only]),
            ("Other problems under the same name", map(": ".join, self.changed)),
            ("Verdicts that changed", self.verdicts(self.names)),
            ("Largest changes of T", self._largest(largest)),
        ):
            every = list(lines)
            if every:
                parts.append("\n".join([f"{title}:", *(f"  {x}" for x in every)]))
        return "\n\n".join(parts)

    def _largest(self, count: int) -> Iterable[str]:
        T = self.ratios("T", self.names)
        order = sorted(T, key=lambda name: -abs(T[name] - 1.0))[:count]
        for name in order:
            a, b = self._pair(name, "T")
            if a != b:
                yield f"{_percent(b / a - 1.0)} {name[0]}: {name[1]} ({a:g} -> {b:g} s)"


def good(row: Row) -> bool:
    """Whether a motion was found that the judge does not refute."""
    return row["success"] == "True" and not row["faults"]


def _verdict(row: Row) -> str:
    word = row["status"] + (", refuted" if row["faults"] else "")
    return word if row["success"] == "True" else f"{word}, no motion"


def _number(row: Row, column: str) -> float:
    try:
        return float(row[column] or "nan")
    except ValueError:
        return math.nan


def _percent(share: float) -> str:
    return f"{100.0 * share:+.3f} %"


def _extreme(ratios: Mapping[Name, float], pick: Callable[..., Name]) -> str:
    """The largest or smallest ratio, with the problem's name."""
    if not ratios:
        return "-"
    name = pick(ratios, key=lambda key: ratios[key])
    return f"{_percent(ratios[name] - 1.0)} ({name[1]})"
