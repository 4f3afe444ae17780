"""Batches from files: a folder of scenarios, or a list of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tominpmp.description.fields import Field
from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ScenarioError
from tominpmp.files.scenario import SECTIONS, read_toml

ENDING = ".toml"


def scenarios_in(source: str | Path) -> list[tuple[str, Path]]:
    """Scenario files that a batch is made of, each with a name of its own.

    Args:
        source: A folder, in which and below which every ``.toml`` is one; a list of
            them, a TOML file with ``problems = ["a.toml", "cells/*.toml"]``, whose
            paths are relative to its folder; or one scenario.

    Returns:
        Names, which are paths without their endings, and paths, in their order.

    Raises:
        ScenarioError: If there is no such file or folder, or nothing in it, or a list
            has other keys.
    """
    path = checked_path(source, "source", ScenarioError)
    if path.is_dir():
        return _named(sorted(path.rglob(f"*{ENDING}")), path, path)
    content = read_toml(path)
    if "problems" not in content and any(key in content for key in SECTIONS):
        return [(path.stem, path)]
    document = Field(content, path)
    document.only("problems")
    listed = document.need("problems")
    found: list[Path] = []
    for item in listed.items():
        pattern = item.text()
        files = _matching(path.parent, pattern)
        if not files:
            item.fail(f"is {pattern!r}, which no file matches")
        found += files
    return _named(list(dict.fromkeys(found)), path.parent, path)


def _matching(folder: Path, pattern: str) -> list[Path]:
    """Files of a pattern; a plain path need not be there, which is told later."""
    if not any(sign in pattern for sign in "*?["):
        return [folder / pattern]
    try:
        return sorted(path for path in folder.glob(pattern) if path.is_file())
    except (ValueError, NotImplementedError):
        return []


def _named(files: list[Path], folder: Path, source: Path) -> list[tuple[str, Path]]:
    if not files:
        raise ScenarioError(f"{source} holds no scenario ({ENDING})", source)
    return [(_name(path, folder), path) for path in files]


def _name(path: Path, folder: Path) -> str:
    try:
        return path.relative_to(folder).with_suffix("").as_posix()
    except ValueError:
        return path.with_suffix("").as_posix()


def summary(outcomes: list[Any]) -> dict[str, Any]:
    """Numbers of a batch that is done: how many, and sums of times [s]."""
    found = [item for item in outcomes if item.success]
    return {
        "problems": len(outcomes),
        "found": len(found),
        "verified": sum(item.verified for item in found),
        "resumed": sum(item.resumed for item in outcomes),
        "T": sum(item.T for item in found),
        "planning_time": sum(item.seconds for item in outcomes),
    }
