"""What the documents point at is there: files, folders, modules, layers, commands."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "tominpmp"
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *(ROOT / folder / "README.md" for folder in ("benchmarks", "robots")),
    *sorted((ROOT / "docs").glob("*.md")),
]
# Where a path in a document may start.
FOLDERS = (ROOT, SOURCE, ROOT / "examples", ROOT / "docs", ROOT / "benchmarks")
# Files and folders of the project in backticks or links; users have no Python files and
# no folders that documents tell of.
PATHS = re.compile(r"`([\w./-]+(?:\.py|\.md|/))`|\]\(([^)#:]+)(?:#[^)]*)?\)")
NAMES = re.compile(r"`(tominpmp(?:\.\w+)+)`")
COMMANDS = re.compile(r"python -m (benchmarks(?:\.\w+)+)")

each_document = pytest.mark.parametrize(
    "document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT))
)


def is_there(text: str, document: Path) -> bool:
    """Whether there is such a file; one without a folder may be in any."""
    if any((folder / text).exists() for folder in (document.parent, *FOLDERS)):
        return True
    return "/" not in text and any(SOURCE.rglob(text))


@each_document
def test_files_and_folders_are_there(document: Path) -> None:
    found = PATHS.findall(document.read_text("utf-8"))
    missing = {
        one or other for one, other in found if not is_there(one or other, document)
    }
    assert missing == set()


@each_document
def test_names_are_there(document: Path) -> None:
    for name in NAMES.findall(document.read_text("utf-8")):
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            module, _, last = name.rpartition(".")
            assert hasattr(importlib.import_module(module), last), name


@each_document
def test_benchmarks_are_there(document: Path) -> None:
    for name in COMMANDS.findall(document.read_text("utf-8")):
        path = ROOT / Path(*name.split("."))
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), name


def test_the_layers_are_those_that_are_checked() -> None:
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    layers = re.search(r"^layers = \[\n(.*?)^\]", text, re.MULTILINE | re.DOTALL)
    assert layers is not None
    checked = [line for line in re.findall(r'"(.*)"', layers[1]) if line != "__main__"]
    contributing = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = contributing.split("## Layers")[1].split("\n- ")[0]
    told = [line for line in section.splitlines() if line.startswith("    ")]
    assert [re.split(r" {2,}", line.strip())[0] for line in told] == checked


REFERENCES = re.compile(r":(?:mod|class|func|meth|data|attr):`~?(tominpmp[\w.]*)`")


def resolved(name: str) -> bool:
    """Whether a dotted name is that of a module, or of something in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for index, part in enumerate(parts[count:], count):
            fields = getattr(found, "__annotations__", {})
            if not hasattr(found, part):
                return part in fields and index == len(parts) - 1
            found = getattr(found, part)
        return True
    return False


def test_references_in_docstrings_are_there() -> None:
    names = {
        name
        for path in SOURCE.rglob("*.py")
        for name in REFERENCES.findall(path.read_text("utf-8"))
    }
    assert len(names) > 20
    assert {name for name in names if not resolved(name)} == set()
