"""Results of the MotionBenchMaker benchmark: the CSV file and its tables."""

from __future__ import annotations

import csv
import os
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

KEY = ("scene", "problem")
Row = dict[str, str]


def read_rows(path: Path, columns: Sequence[str] | None = None) -> list[Row]:
    """Rows of a CSV file, without an incomplete last row after an interruption.

    Args:
        path: The file.
        columns: Names of the columns; None for any.

    Raises:
        SystemExit: If the file has other columns.
    """
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if columns is not None and reader.fieldnames != list(columns):
            raise SystemExit(f"{path} has other columns; choose another --out")
        return [row for row in reader if None not in row.values()]


class Table:
    """The CSV file: rows of earlier runs, and rows added one by one.

    Args:
        path: The file.
        columns: Names of the columns.

    Raises:
        SystemExit: If the file is there and has other columns.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._path, self._columns = path, list(columns)
        self.rows: dict[tuple[str, ...], Row] = {}
        if path.exists() and path.stat().st_size:
            for row in read_rows(path, columns):
                self.rows[tuple(row[name] for name in KEY)] = row

    def add(self, row: Row) -> None:
        """Add a row and write all to the disk at once."""
        self.rows[tuple(row[name] for name in KEY)] = row
        self._path.parent.mkdir(parents=True, exist_ok=True)
        draft = self._path.with_name(self._path.name + ".part")
        with draft.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._columns, restval="")
            writer.writeheader()
            writer.writerows(self.rows.values())
            file.flush()
            os.fsync(file.fileno())
        draft.replace(self._path)


def _numbers(rows: Sequence[Row], column: str) -> list[float]:
    return [float(row[column]) for row in rows if row.get(column)]


def _cell(
    rows: Sequence[Row], column: str, pick: Callable[[Sequence[float]], float]
) -> str:
    values = _numbers(rows, column)
    return f"{pick(values):.3f}" if values else "-"


def percentile_95(values: Sequence[float]) -> float:
    """95th percentile."""
    return float(np.percentile(values, 95))


def durations(rows: Sequence[Row], others: Sequence[Row]) -> NDArray[np.float64]:
    """T of the problems that both runs have solved, shape (k, 2) [s]."""
    known = {
        tuple(row[k] for k in KEY): row for row in others if row["success"] == "True"
    }
    pairs = [
        (float(row["T"]), float(known[key]["T"]))
        for row in rows
        if row["success"] == "True" and (key := tuple(row[k] for k in KEY)) in known
    ]
    return np.array(pairs).reshape(-1, 2)


def compare(rows: Sequence[Row], others: Sequence[Row]) -> tuple[float, int]:
    """Ratio of mean T of two runs where both succeeded, and the number of problems.

    Returns:
        The ratio, nan if there is nothing to compare, and the number of problems.
    """
    both = durations(rows, others)
    if not both.size:
        return float("nan"), 0
    ours, theirs = both.sum(axis=0)
    return float(ours / theirs), len(both)


def excess_line(rows: Sequence[Row], others: Sequence[Row]) -> str:
    """Excess of T over the shorter motion of both runs, in a line."""
    both = durations(rows, others)
    if not both.size:
        return "No problem was solved in both runs."
    excess = both[:, 0] / both.min(axis=1) - 1.0
    close, near = (100.0 * np.mean(excess <= share) for share in (0.01, 0.05))
    return (
        f"Of {len(both)} problems T is within 1 % of the shorter motion of both runs "
        f"on {close:.1f} %, within 5 % on {near:.1f} %, and {100.0 * excess.max():.1f} "
        "% above it at most."
    )


def markdown_table(rows: Sequence[Row], others: Sequence[Row] = ()) -> str:
    """Table per scene and overall.

    Args:
        rows: Rows of this run.
        others: Rows of the rival, if any.
    """
    header = ["scene", "solved", "mean T [s]", "median s", "95 % s", "max s"]
    header += ["least clearance [mm]", "largest excess [%]"]
    if others:
        header += ["rival: solved", "median s", "95 % s"]
        header += ["mean T / rival's", "both solved"]
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    for scene in [*dict.fromkeys(row["scene"] for row in rows), "all"]:
        group = [row for row in rows if scene in ("all", row["scene"])]
        solved = [row for row in group if row["success"] == "True"]
        share = f" ({len(solved) / len(group):.1%})" if scene == "all" else ""
        cells = [
            scene,
            f"{len(solved)} / {len(group)}{share}",
            _cell(solved, "T", statistics.fmean),
            _cell(group, "process_seconds", statistics.median),
            _cell(group, "process_seconds", percentile_95),
            _cell(group, "process_seconds", max),
            _cell(solved, "clearance", lambda values: 1e3 * min(values)),
            _cell(solved, "limit_excess", lambda values: 100 * max(values)),
        ]
        if others:
            rivals = [row for row in others if scene in ("all", row["scene"])]
            cells += [
                f"{sum(row['success'] == 'True' for row in rivals)} / {len(rivals)}",
                _cell(rivals, "process_seconds", statistics.median),
                _cell(rivals, "process_seconds", percentile_95),
            ]
            ratio, count = compare(group, others)
            cells += [f"{ratio:.3f}", str(count)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def failures(rows: Sequence[Row]) -> list[str]:
    """One line for each problem that was not solved."""
    return [
        f"{row['scene']} {row['problem']}: {row['status']}"
        + (f" ({row['faults']})" if row.get("faults") else "")
        for row in rows
        if row["success"] != "True"
    ]
