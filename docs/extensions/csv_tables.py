"""Tables of measurements as CSV files, each linked below its table."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1]
FOLDER = DOCS / "build" / "tables"
# Pages of figures.
PAGES = ("benchmarks", "known_optima", "robustness", "parallel_rows")
TABLE = re.compile(r"^\|.*\|\n\|[-:| ]+\|\n(?:\|.*\|(?:\n|\Z))+", re.MULTILINE)
CELL = re.compile(r"(?<!\\)\|")
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")


def rows_of(table: str) -> list[list[str]]:
    """Cells of a table of Markdown, without its marks; the head comes first."""
    lines = [line for number, line in enumerate(table.splitlines()) if number != 1]
    return [[plain(cell) for cell in CELL.split(line.strip())[1:-1]] for line in lines]


def plain(cell: str) -> str:
    """Text of a cell."""
    text = LINK.sub(r"\1", cell).replace("`", "").replace("**", "")
    return text.replace(r"\|", "|").strip()


def with_files(page: str, text: str, folder: Path) -> str:
    """Write the tables of a page into a folder, and link to them below each.

    Args:
        page: Name of the page.
        text: Its Markdown.
        folder: Folder of the files.

    Returns:
        The Markdown with the links.
    """
    folder.mkdir(parents=True, exist_ok=True)
    count = 0

    def linked(found: re.Match[str]) -> str:
        nonlocal count
        count += 1
        name = f"{page}_{count}.csv"
        with (folder / name).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file).writerows(rows_of(found[0]))
        link = f'<a class="csv" href="csv/{name}" download>as CSV</a>'
        return f"{found[0].rstrip()}\n\n```{{raw}} html\n{link}\n```\n\n"

    return TABLE.sub(linked, text)


def setup(app: Any) -> dict[str, Any]:
    """Write the files when pages are read."""

    def begin(app: Any) -> None:
        app.config.html_extra_path = [*app.config.html_extra_path, str(FOLDER)]

    def read(_: Any, name: str, source: list[str]) -> None:
        if name in PAGES:
            source[0] = with_files(name, source[0], FOLDER / "csv")

    FOLDER.mkdir(parents=True, exist_ok=True)
    # After the extension of playback pages has set its folders.
    app.connect("builder-inited", begin, priority=600)
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
