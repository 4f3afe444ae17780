"""The list of tests that only `make test-all` runs names tests that there are."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
LINES = (ROOT / "tests" / "nightly.txt").read_text("utf-8").splitlines()


def test_they_are_there() -> None:
    missing = []
    for line in LINES:
        file, name = line.split("[")[0].split("::")
        path = ROOT / file
        if not path.exists() or f"def {name}(" not in path.read_text("utf-8"):
            missing.append(line)
    assert missing == []


def test_none_is_named_twice_and_all_are_sorted() -> None:
    assert sorted(set(LINES)) == LINES


def test_there_is_no_other_list() -> None:
    """Marks in the code would be a second one."""
    mark = "mark." + "nightly"
    files = (ROOT / "tests").rglob("test_*.py")
    assert [file.name for file in files if mark in file.read_text("utf-8")] == []
