"""Writing TOML as people write it: by tomli-w, but rows of numbers on one line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import tomli_w

# A list without lists or texts in it; texts hold no line breaks.
_ROW = re.compile(r"\[\n([^][\"]*)\]")


def toml_text(table: Mapping[str, Any]) -> str:
    """Write a document.

    Args:
        table: Texts, truth values, numbers, lists, and tables of them; a list of tables
            becomes an array of tables. Keys and lists keep their order, but plain
            values come before tables, as TOML demands.

    Returns:
        The document, which ends with a line break.
    """

    def on_one_line(row: re.Match[str]) -> str:
        return f"[{' '.join(row[1].split()).removesuffix(',')}]"

    return _ROW.sub(on_one_line, tomli_w.dumps(table))
