"""Tables of names, defaults and meanings, from docstrings and fields."""

from __future__ import annotations

import inspect
import re
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

import tominpmp as tm

ENTRY = re.compile(r"^    (\w+)(?: \(.*\))?: (.*(?:\n(?:     .*|$))*)", re.MULTILINE)
ROLE = re.compile(r":\w+:`~?(?:[\w.]*\.)?(\w+)`")


def entries(text: str | None, heading: str) -> dict[str, str]:
    """Descriptions of arguments or attributes in a docstring, in one line each."""
    body = inspect.cleandoc(text or "").partition(f"\n{heading}:\n")[2]
    body = re.split(r"^\S", body, maxsplit=1, flags=re.MULTILINE)[0]
    return {name: plain(words) for name, words in ENTRY.findall(body)}


def plain(words: str) -> str:
    """Convert the markup of docstrings to Markdown, on one line."""
    text = ROLE.sub(r"`\1`", " ".join(words.split()))
    text = re.sub(r"``docs/([\w/]+)\.md``", r"[\1](/\1.md)", text)
    return re.sub(r"``(.*?)``", r"`\1`", text).replace("|", r"\|")


def summary(kind: Any) -> str:
    """Return the first paragraph of a docstring."""
    return plain(inspect.cleandoc(kind.__doc__ or "").split("\n\n")[0])


def default(item: Any) -> str:
    """Return the default of a field as code, or a word if it has no default."""
    if item.default is MISSING and item.default_factory is MISSING:
        return "required"
    value = item.default if item.default is not MISSING else item.default_factory()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return "empty" if isinstance(value, tm.Scene) else f"`{value!r}`"


def field_rows(
    kind: type[Any],
    texts: Mapping[str, str] | None = None,
    without: Collection[str] = (),
) -> list[str]:
    """Table of the fields of a class: name, default, meaning; some may be left out."""
    if texts is None:
        texts = {}
        for base in reversed(kind.__mro__):
            texts = texts | entries(base.__doc__, "Attributes")
    rows = ["| key | default | meaning |", "|---|---|---|"]
    for item in fields(kind):
        if item.init and item.name not in without:
            meaning = texts.get(item.name, "")
            rows.append(f"| `{item.name}` | {default(item)} | {meaning} |")
    return rows


def kinds(
    found: Mapping[str, type[Any]],
    level: int = 3,
    rows: Mapping[type[Any], list[str]] | None = None,
) -> list[str]:
    """A section for each class of a family, by its name in files.

    Args:
        found: The classes by their names.
        level: Level of the headings.
        rows: Tables of classes whose keys are not their fields.
    """
    lines: list[str] = []
    for name, kind in sorted(found.items()):
        lines += [f"{'#' * level} `{name}` — `{kind.__name__}`", "", summary(kind), ""]
        lines += [*((rows or {}).get(kind) or field_rows(kind)), ""]
    return lines
