"""The list tests/nightly.txt of the tests that only `make test-all` runs."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
LINES = (ROOT / "tests" / "nightly.txt").read_text("utf-8").splitlines()


def test_every_entry_names_an_existing_test() -> None:
    missing = []
    for line in LINES:
        file, name = line.split("[")[0].split("::")
        path = ROOT / file
        if not path.exists() or f"def {name}(" not in path.read_text("utf-8"):
            missing.append(line)
    assert missing == []


def test_entries_are_unique_and_sorted() -> None:
    assert sorted(set(LINES)) == LINES


def test_no_test_file_contains_the_mark_nightly() -> None:
    """Marks in the code would be a second list of long tests."""
    mark = "mark." + "nightly"
    files = (ROOT / "tests").rglob("test_*.py")
    assert [file.name for file in files if mark in file.read_text("utf-8")] == []
