"""Rows of a benchmark: a CSV file that grows row by row, and a table in Markdown."""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any


def one_thread() -> None:
    """Limit every solver to one thread; call it before numerical libraries load."""
    for name in ("OMP", "OPENBLAS", "MKL", "HIGHS"):
        os.environ[f"{name}_NUM_THREADS"] = "1"


class Sheet:
    """A CSV file whose rows are on the disk as soon as they are known.

    Args:
        path: The file; an existing file is replaced.
        columns: Names of the columns.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.rows: list[dict[str, Any]] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._file, list(columns))
        self._writer.writeheader()

    def add(self, row: Mapping[str, Any]) -> None:
        """Add a row and show it."""
        self.rows.append(dict(row))
        self._writer.writerow(row)
        self._file.flush()
        print(", ".join(_short(v) for v in row.values()), file=sys.stderr, flush=True)

    def column(self, name: str, **where: Any) -> list[Any]:
        """Values of a column in the rows with the given values of other columns."""
        return [
            row[name]
            for row in self.rows
            if all(row[key] == value for key, value in where.items())
        ]


def markdown(header: Sequence[str], lines: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    table = [header, ["---"] * len(header), *lines]
    return "\n".join("| " + " | ".join(map(_short, line)) + " |" for line in table)


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
