"""The installation page lists each dependency and extra, with correct sizes."""

from __future__ import annotations

import re
from pathlib import Path

from tools.dependency_sizes import closure, own_size, plain, requirements, rows

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "installation.md").read_text("utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def name_of(requirement: str) -> str:
    return plain(re.split(r"[^\w.-]", requirement)[0])


def test_page_lists_exactly_the_dependencies() -> None:
    listed = set(re.findall(r"^\| ([\w-]+) \|", PAGE, re.MULTILINE)) - {"package"}
    assert listed - {"extra"} == {name_of(text) for text in PROJECT["dependencies"]}


def test_page_lists_every_extra() -> None:
    listed = dict(re.findall(r"^\| `(\w+)` \(([\w-]+)\) \|", PAGE, re.MULTILINE))
    extras = PROJECT["optional-dependencies"]
    filled = {k: name_of(v[0]) for k, v in extras.items() if v and k != "all"}
    assert listed == filled
    for name in set(extras) - set(filled) - {"all"}:
        assert f"`{name}`" in PAGE  # an extra without packages of its own


def test_size_of_a_package_is_that_of_its_files() -> None:
    numpy = next(item for item in requirements() if item.name == "numpy")
    assert closure(numpy) == {"numpy"}
    assert own_size("numpy") > 10_000_000
    assert own_size("no-such-distribution") == 0


def test_sizes_on_the_page_are_about_right() -> None:
    """Each size above 1 MB, of the package itself and with its own dependencies."""
    row = r"^\| ([\w-]+) \| ([\d.]+) \| ([\d.]+) \|"
    listed = {name: sizes for name, *sizes in re.findall(row, PAGE, re.MULTILINE)}
    for name, *measured in rows("", set()):
        for size, on_page in zip(measured, map(float, listed[name]), strict=True):
            assert size < 1.0 or 0.4 < size / on_page < 2.5, name
