"""Writing TOML: the few forms that scenario files need."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
# Lists of numbers longer than this get a line each entry.
_LINE = 88


def toml_text(table: Mapping[str, Any]) -> str:
    """Write a document.

    Args:
        table: Texts, truth values, numbers, lists, and tables of them; a list of tables
            becomes an array of tables. Keys and lists keep their order, but plain
            values come before tables, as TOML demands.

    Returns:
        The document, which ends with a line break.
    """
    lines: list[str] = []
    _write_table(table, "", lines)
    return "\n".join(lines).strip() + "\n"


def _write_table(table: Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    plain = {k: v for k, v in table.items() if not _is_section(v)}
    for key, value in plain.items():
        lines.append(f"{_key(key)} = {_value(value, len(_key(key)) + 3)}")
    for key, value in table.items():
        if key in plain:
            continue
        name = f"{prefix}.{_key(key)}" if prefix else _key(key)
        for item in [value] if isinstance(value, Mapping) else value:
            only_sections = item and all(map(_is_section, item.values()))
            if not isinstance(value, Mapping):
                lines += ["", f"[[{name}]]"]
            elif not only_sections:
                lines += ["", f"[{name}]"]
            _write_table(item, name, lines)


def _is_section(value: object) -> bool:
    """Whether a value gets a heading of its own."""
    if isinstance(value, Mapping):
        return True
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    return is_list and bool(value) and all(isinstance(v, Mapping) for v in value)  # type: ignore[attr-defined]


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    # As JSON writes it, but for the last control character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def _value(value: Any, used: int = 0) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return "nan" if math.isnan(value) else repr(value)
    parts = [_value(item) for item in value]
    line = f"[{', '.join(parts)}]"
    if used + len(line) <= _LINE or not any(isinstance(v, list) for v in value):
        return line
    return "[\n" + "".join(f"  {part},\n" for part in parts) + "]"
