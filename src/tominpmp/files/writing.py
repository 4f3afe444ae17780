"""Atomic writing of files, which are complete or absent; and TOML documents."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import tomli_w

from tominpmp.description.paths import checked_path
from tominpmp.exceptions import ScenarioError

# A list of plain values without texts; string literals contain no line breaks.
_ROW = re.compile(r"\[\n([^][\"]*)\]")


def why_unwritable(path: Path) -> str:
    """Reason for which a file cannot be written, in a clause; empty without a reason.

    A folder or a device is not replaced by a file: that would damage the system.
    """
    folder, name = str(path.parent), repr(str(path))
    kind = "a folder" if path.is_dir() else "not a regular file"
    place = Path(os.path.realpath(path)).parent  # of the target of a symbolic link
    reasons = {
        f"there is no folder {folder!r}": not path.parent.is_dir(),
        f"{name} is {kind}": path.exists() and not path.is_file(),
        f"the folder {folder!r} cannot be written to": not os.access(place, os.W_OK),
        f"{name} is read-only": path.exists() and not os.access(path, os.W_OK),
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def write_file(path: str | Path, write: Callable[[BinaryIO], object]) -> Path:
    """Write a file completely or not at all.

    The contents go to a temporary file in the same folder, which is then renamed: after
    a full disk or an interruption the former file is unchanged.

    Args:
        path: File to write; an existing one is replaced, and its permissions are kept.
        write: Function that writes the contents to an open binary file.

    Raises:
        ProblemError: If the path is invalid.
        ScenarioError: If the file cannot be written; names its path.
    """
    path = checked_path(path)
    if reason := why_unwritable(path):
        raise ScenarioError(reason, path)
    try:
        # A symbolic link is kept, and its target replaced, unless that is the link.
        target = Path(os.path.realpath(path))
        draft = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")
        try:
            with draft.open("xb") as file:
                if target.exists():
                    shutil.copymode(target, draft)
                write(file)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(target)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioError(f"{path} cannot be written: {reason}", path) from error
    return path


def write_bytes(path: str | Path, content: bytes) -> Path:
    """Write bytes to a file as :func:`write_file` does."""
    return write_file(path, lambda file: file.write(content))


def toml_text(table: Mapping[str, Any]) -> str:
    """Format a TOML document with tomli-w, but with rows of numbers on one line.

    Args:
        table: Texts, truth values, numbers, lists, and tables of them; a list of tables
            becomes an array of tables. Keys and lists keep their order, except that
            plain values come before tables, as TOML requires.

    Returns:
        The document, ending with a line break.
    """

    def on_one_line(row: re.Match[str]) -> str:
        return f"[{' '.join(row[1].split()).removesuffix(',')}]"

    return _ROW.sub(on_one_line, tomli_w.dumps(table))
