"""Documents name existing files, folders, modules, layers and benchmarks."""

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
# Folders to which a path in a document may be relative.
FOLDERS = (ROOT, SOURCE, ROOT / "examples", ROOT / "docs", ROOT / "benchmarks")
# Files and folders of the project in backticks or links: documents name no Python files
# and no folders of users.
PATHS = re.compile(r"`([\w./-]+(?:\.py|\.md|/))`|\]\(([^)#:]+)(?:#[^)]*)?\)")
NAMES = re.compile(r"`(tominpmp(?:\.\w+)+)`")
COMMANDS = re.compile(r"python -m (benchmarks(?:\.\w+)+)")


def path_exists(text: str, document: Path) -> bool:
    """Whether a path exists; a file without a folder may be anywhere in the package."""
    if any((folder / text).exists() for folder in (document.parent, *FOLDERS)):
        return True
    return "/" not in text and any(SOURCE.rglob(text))


def mentions(pattern: re.Pattern[str]) -> Iterator[tuple[Path, str]]:
    """Matches of a pattern in the documents, each with its document."""
    for document in DOCUMENTS:
        for groups in pattern.finditer(document.read_text("utf-8")):
            yield document, next(group for group in groups.groups() if group)


def test_files_and_folders_in_documents_exist() -> None:
    missing = [
        f"{document.relative_to(ROOT)}: {text}"
        for document, text in mentions(PATHS)
        if not path_exists(text, document)
    ]
    assert missing == []


def test_dotted_names_in_documents_exist() -> None:
    missing = [
        f"{document.relative_to(ROOT)}: {name}"
        for document, name in mentions(NAMES)
        if not name_exists(name)
    ]
    assert missing == []


def test_benchmark_commands_in_documents_exist() -> None:
    missing = []
    for document, name in mentions(COMMANDS):
        path = ROOT / Path(*name.split("."))
        program = path / "__main__.py"
        if not (path.with_suffix(".py").exists() or program.exists()):
            missing.append(f"{document.relative_to(ROOT)}: {name}")
    assert missing == []


def test_documented_layers_are_those_of_import_linter() -> None:
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    layers = re.search(r"^layers = \[\n(.*?)^\]", text, re.MULTILINE | re.DOTALL)
    assert layers is not None
    checked = [line for line in re.findall(r'"(.*)"', layers[1]) if line != "__main__"]
    contributing = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = contributing.split("## Layers")[1].split("\n- ")[0]
    documented = [line for line in section.splitlines() if line.startswith("    ")]
    assert [re.split(r" {2,}", line.strip())[0] for line in documented] == checked


REFERENCES = re.compile(r":(?:mod|class|func|meth|data|attr):`~?(tominpmp[\w.]*)`")


def name_exists(name: str) -> bool:
    """Whether a dotted name is that of a module, or of an attribute in a module."""
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


def test_references_in_docstrings_exist() -> None:
    names = {
        name
        for path in SOURCE.rglob("*.py")
        for name in REFERENCES.findall(path.read_text("utf-8"))
    }
    assert len(names) > 20
    assert {name for name in names if not name_exists(name)} == set()
