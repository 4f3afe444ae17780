"""Paths from a caller or a file, checked before use."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path

from tominpmp.exceptions import ProblemError, ScenarioError, TominpmpError, brief

# Limits of file systems [bytes]; longer paths fail with obscure errors.
LONGEST_NAME = 255
LONGEST_PATH = 4096


def checked_ending(path: object, known: Collection[str], refused: str) -> str:
    """Return the ending of a caller's path, in lower case.

    Args:
        path: The path.
        known: The supported endings.
        refused: Beginning of the message for other endings, as "motions are not kept
            as".

    Raises:
        ProblemError: If the ending is not supported, or the path is invalid.
    """
    ending = checked_path(path).suffix.lower()
    if ending not in known:
        raise ProblemError(
            f"{path}: {refused} {ending or 'files without ending'}; "
            f"there are: {', '.join(known)}",
            "path",
        )
    return ending


def checked_path(
    path: object,
    name: str = "path",
    error: type[TominpmpError] = ProblemError,
    expected: str = "the path of a file",
) -> Path:
    """Check a caller's path, and expand ``~`` to the home folder.

    Returns:
        The path; ``~user`` remains unchanged for an unknown user.

    Raises:
        TominpmpError: If it is not a valid path of a file; of the given class.
    """
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if isinstance(text, str) and text and "\0" not in text:
        try:
            text = os.path.expanduser(text)
            encoded = os.fsencode(text)
        except (ValueError, OSError):
            encoded = b""
        longest = max(map(len, encoded.replace(b"\\", b"/").split(b"/")))
        if 0 < len(encoded) <= LONGEST_PATH and longest <= LONGEST_NAME:
            return Path(text)
        expected += f", each name in it of at most {LONGEST_NAME} bytes"
    message = f"{name} is {brief(path)}, expected {expected}"
    if issubclass(error, ProblemError):
        raise error(message, name)
    raise error(message)


def read_bytes(
    path: Path,
    largest: int,
    error: Callable[[str, Path], TominpmpError] = ScenarioError,
) -> bytes:
    """Read a file for parsing, up to a largest size in bytes.

    Raises:
        TominpmpError: If it is missing, not a regular file, too large or cannot be
            read; made by ``error`` of a message and the path.
    """
    try:
        if path.is_dir():
            raise error(f"{path} is a folder, expected a file", path)
        if not path.is_file():
            special = f"{path} is not a regular file"
            raise error(special if path.exists() else f"there is no file {path}", path)
        size = path.stat().st_size
        if size > largest:
            raise error(
                f"{path} has {size} bytes, more than the {largest} it may have", path
            )
        return path.read_bytes()
    except (OSError, ValueError) as fault:
        raise error(f"{path} cannot be read: {fault}", path) from fault
