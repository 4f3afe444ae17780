"""Reference pages from the code: content is inserted when a page is read.

A line ``<!-- from the code: NAME -->`` in a page is replaced by the output of the
function of this name in ``CONTENTS``. So no list is copied by hand.
"""

from __future__ import annotations

import inspect
import io
import re
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

from file_keys import scenario_example, scenario_keys, tour_keys
from tables import entries, field_rows, kinds, plain, summary

import tominpmp as tm
from tominpmp import exceptions
from tominpmp.cli.app import run
from tominpmp.cli.front import COMMANDS
from tominpmp.constraints.path import PathConstraint
from tominpmp.datasheets import datasheets
from tominpmp.files.records import classes
from tominpmp.goals.base import Goal
from tominpmp.scene.motion import Motion
from tominpmp.scene.obstacles import Obstacle

PLACE = re.compile(r"^<!-- from the code: (\w+) -->$", re.MULTILINE)
# Blocks of code of a page, cells of notebooks among them.
CODE = re.compile(
    r"^```+(?:python|\{code-cell\}[^\n]*)\n(.*?)^```+ *$", re.MULTILINE | re.DOTALL
)
DOCS = Path(__file__).parents[1]
FAMILIES = (Goal, PathConstraint, Obstacle, tm.Motion)
ALL_NAMES = "reference/examples"  # the page on which every public name is used

# Pages of the Python reference, each with its parts of the library in the order of
# their use; parts that are not listed are at the end of the last page.
PARTS = {
    "task": (
        "robot",
        "combined_robots",
        "scene",
        "goals",
        "problem",
        "constraints",
        "motion_limits",
    ),
    "plan": ("planner", "options", "solution", "motion", "status"),
    "proofs": ("verification", "certificate", "bounds"),
    "files": ("files",),
    "cells": ("cell",),
}


def options() -> list[str]:
    """All options of a plan."""
    return field_rows(tm.Options)


def goals() -> list[str]:
    """All goals."""
    return kinds(classes(Goal), 2)


def obstacles() -> list[str]:
    """All shapes of obstacles, and their motions."""
    return [*kinds(classes(Obstacle), 2), "## Motions", "", *kinds(classes(Motion))]


def constraints() -> list[str]:
    """All constraints along a motion."""
    return kinds(classes(PathConstraint), 2)


def errors() -> list[str]:
    """Every exception with its attributes and its remedy."""
    lines: list[str] = []
    for name, kind in vars(exceptions).items():
        if name not in tm.__all__ or not inspect.isclass(kind):
            continue
        text = inspect.cleandoc(kind.__doc__ or "").split("\nAttributes:\n")[0]
        public = [k.__name__ for k in kind.__mro__[1:] if k.__name__[0] != "_"]
        lines += [f"## `{name}`", "", f"A `{public[0]}`.", ""]
        lines += [plain(part) + "\n" for part in text.split("\n\n")]
        kept = entries(kind.__doc__, "Attributes")
        lines += [f"- `{key}`: {words}" for key, words in kept.items()]
        lines.append("")
    return lines


def statuses() -> list[str]:
    """Statuses of a plan."""
    rows = ["| status | what the message says |", "|---|---|"]
    return rows + [f"| `Status.{item.name}` | {item.value} |" for item in tm.Status]


def command_line() -> list[str]:
    """The help of every command, as shown in a terminal."""
    lines: list[str] = []
    for words in ([], *([name] for name in COMMANDS)):
        shown = io.StringIO()
        with redirect_stdout(shown):
            run([*words, "--help"])
        title, text = " ".join(("tominpmp", *words)), shown.getvalue().rstrip()
        lines += [f"## `{title}`", "", "```text", text, "```", ""]
    return lines


def data_sheets() -> list[str]:
    """Robots whose makers' limits come with the package."""
    rows = ["| arm | found by |", "|---|---|"]
    for sheet in datasheets():
        names = ", ".join(f"`{name}`" for name in sheet.names)
        rows.append(f"| {sheet.title} | {names} |")
    return rows


def names_of(page: str) -> list[str]:
    """Public names on a page of the Python reference: functions before classes."""
    listed = {part for parts in PARTS.values() for part in parts} | {"exceptions"}
    parts = {name: getattr(tm, name).__module__.split(".")[1] for name in tm.__all__}
    found = [name for part in PARTS[page] for name in parts if parts[name] == part]
    if page == list(PARTS)[-1]:
        found += [name for name in parts if parts[name] not in listed]
    return sorted(found, key=lambda name: inspect.isclass(getattr(tm, name)))


def public_names() -> list[str]:
    """A table of all public names, with their descriptions and uses."""
    lines: list[str] = []
    for page in PARTS:
        heading = page_title(page)
        rows = ["| name | what it is | an example |", "|---|---|---|"]
        for name in names_of(page):
            where = f"[`{name}`](#tominpmp.{name})"
            shown = ", ".join(f"[{title}](/{at})" for at, title in examples_of(name))
            rows.append(f"| {where} | {summary(getattr(tm, name))} | {shown} |")
        lines += [f"## [{heading}](api_{page}.md)", "", *rows, ""]
    return lines


def page_title(page: str) -> str:
    """Title of a page of the Python reference."""
    text = (DOCS / "reference" / f"api_{page}.md").read_text("utf-8")
    return text.partition("\n")[0].removeprefix("# ")


@cache
def _codes() -> dict[str, tuple[str, str]]:
    """Title and code of every page, by its path without ending."""
    found = {}
    for path in sorted(DOCS.rglob("*.md")):
        if DOCS / "build" in path.parents:
            continue
        text = path.read_text("utf-8")
        title = re.search(r"^# (.*)$", text, re.MULTILINE)
        code = "\n".join(CODE.findall(text))
        at = path.relative_to(DOCS).with_suffix("").as_posix()
        found[at] = (title[1] if title else at, code)
    return found


def examples_of(name: str) -> list[tuple[str, str]]:
    """Pages whose code uses a public name, at most two, with their titles.

    Pages for newcomers come first, the page that uses all names last.
    """
    use = re.compile(rf"\btm\.{name}\b")
    pages = [(at, title) for at, (title, code) in _codes().items() if use.search(code)]
    order = ("start", "how_to", "notebooks")

    def place(item: tuple[str, str]) -> tuple[bool, int, str]:
        top = item[0].partition("/")[0]
        known = order.index(top) if top in order else len(order)
        return item[0] == ALL_NAMES, known, item[0]

    return sorted(pages, key=place)[:2]


def names_of_task() -> list[str]:
    """Names that describe a task."""
    return _documented("task")


def names_of_plan() -> list[str]:
    """Names for planning and its results."""
    return _documented("plan")


def names_of_proofs() -> list[str]:
    """Names for verification and proofs."""
    return _documented("proofs")


def names_of_files() -> list[str]:
    """Names for reading and writing files."""
    return _documented("files")


def names_of_cells() -> list[str]:
    """Names for planning many motions."""
    return _documented("cells")


def _documented(page: str) -> list[str]:
    lines = ["```{eval-rst}"]
    for name in names_of(page):
        value = getattr(tm, name)
        kind = "autoclass" if inspect.isclass(value) else "autofunction"
        if not (inspect.isclass(value) or callable(value)):
            kind = "autodata"
        shown = ", ".join(f":doc:`{title} </{at}>`" for at, title in examples_of(name))
        lines += [f".. {kind}:: tominpmp.{name}"]
        if (
            inspect.isclass(value)
            and issubclass(value, FAMILIES)
            and value not in FAMILIES
        ):
            # Members that a family inherits are documented once, in the base class.
            lines += ["   :no-members:"]
        lines += ["", f"   Example: {shown}.", ""]
    return [*lines, "```"]


def further_pages() -> list[str]:
    """A table of contents of the pages that no other table of contents names."""
    texts = [path.read_text("utf-8") for path in DOCS.rglob("*.md")]
    bodies = re.findall(r"```\{toctree\}\n(.*?)```", "\n".join(texts), re.DOTALL)
    named = {Path(line).name for body in bodies for line in body.split()} | {"index"}
    rest = sorted(path.stem for path in DOCS.glob("*.md") if path.stem not in named)
    return ["```{toctree}", ":hidden:", ":caption: Further", "", *rest, "```"]


CONTENTS: dict[str, Callable[[], list[str]]] = {
    function.__name__: function
    for function in (
        options,
        goals,
        obstacles,
        constraints,
        scenario_keys,
        scenario_example,
        tour_keys,
        errors,
        statuses,
        command_line,
        data_sheets,
        public_names,
        names_of_task,
        names_of_plan,
        names_of_proofs,
        names_of_files,
        names_of_cells,
        further_pages,
    )
}


def filled(text: str) -> str:
    """Insert the requested content into a page."""
    return PLACE.sub(lambda found: "\n".join(CONTENTS[found[1]]()), text)


def setup(app: Any) -> dict[str, Any]:
    """Fill pages when they are read."""

    def read(_: Any, __: str, source: list[str]) -> None:
        source[0] = filled(source[0])

    def bars(*arguments: Any) -> None:
        # Vertical bars of absolute values are not substitutions.
        lines: list[str] = arguments[-1]
        lines[:] = [line.replace("|", r"\|") for line in lines]

    app.connect("source-read", read)
    app.connect("autodoc-process-docstring", bars)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
