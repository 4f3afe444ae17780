"""What the documents point at is there: files, folders, modules, layers, commands."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

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


def is_there(text: str, document: Path) -> bool:
    """Whether there is such a file; one without a folder may be in any."""
    if any((folder / text).exists() for folder in (document.parent, *FOLDERS)):
        return True
    return "/" not in text and any(SOURCE.rglob(text))


def mentions(pattern: re.Pattern[str]) -> Iterator[tuple[Path, str]]:
    """What a pattern finds in the documents, beside the document."""
    for document in DOCUMENTS:
        for groups in pattern.finditer(document.read_text("utf-8")):
            yield document, next(group for group in groups.groups() if group)


def test_files_and_folders_are_there() -> None:
    missing = [
        f"{document.relative_to(ROOT)}: {text}"
        for document, text in mentions(PATHS)
        if not is_there(text, document)
    ]
    assert missing == []


def test_names_are_there() -> None:
    missing = [
        f"{document.relative_to(ROOT)}: {name}"
        for document, name in mentions(NAMES)
        if not resolved(name)
    ]
    assert missing == []


def test_benchmarks_are_there() -> None:
    missing = []
    for document, name in mentions(COMMANDS):
        path = ROOT / Path(*name.split("."))
        program = path / "__main__.py"
        if not (path.with_suffix(".py").exists() or program.exists()):
            missing.append(f"{document.relative_to(ROOT)}: {name}")
    assert missing == []


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
