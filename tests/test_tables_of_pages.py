"""Tables of measurements in the documents are also CSV files."""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
sys.path.insert(0, str(DOCS / "extensions"))
import csv_tables  # noqa: E402

PAGE = "A\n\n| a | `b` |\n|---|--:|\n| [x](y.md) | **1** |\n| u \\| v | |\n\nB\n"


def rows_in(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_table_is_written_to_a_file_with_a_link(tmp_path: Path) -> None:
    linked = csv_tables.with_files("page", PAGE, tmp_path)
    link = linked.index('href="csv/page_1.csv"')
    assert linked.index("| u") < link < linked.index("B")
    assert rows_in(tmp_path / "page_1.csv") == [["a", "b"], ["x", "1"], ["u | v", ""]]


@pytest.mark.parametrize("page", csv_tables.PAGES)
def test_tables_of_pages_are_complete(page: str, tmp_path: Path) -> None:
    text = (DOCS / f"{page}.md").read_text("utf-8")
    csv_tables.with_files(page, text, tmp_path)
    files = sorted(tmp_path.glob("*.csv"))
    rules = re.findall(r"^\|[ :]*--", text, re.MULTILINE)
    assert len(files) == len(rules) > 0
    for path in files:
        rows = rows_in(path)
        assert len(rows) > 1
        assert {len(row) for row in rows} == {len(rows[0])}, path
