"""Paths from a caller or a file, checked before use; files read and written whole."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Collection
from pathlib import Path
from typing import BinaryIO

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


def why_unwritable(path: Path) -> str:
    """Reason for which a file cannot be written, in a clause; empty without a reason.

    A folder or a device is not replaced by a file: that would damage the system.
    """
    name, place = repr(str(path)), Path(os.path.realpath(path)).parent
    # The folder of the target of a symbolic link, or the folder as the caller names it.
    folder = str(place if path.is_symlink() else path.parent)
    # Unlike those of paths, these functions raise no errors about permissions.
    exists, regular = os.path.exists(path), os.path.isfile(path)
    kind = "a folder" if os.path.isdir(path) else "not a regular file"
    reasons = {
        f"there is no folder {folder!r}": not os.path.isdir(place),
        f"{name} is {kind}": exists and not regular,
        f"the folder {folder!r} cannot be written to": not os.access(place, os.W_OK),
        f"{name} is read-only": exists and not os.access(path, os.W_OK),
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
    try:
        if reason := why_unwritable(path):
            raise ScenarioError(reason, path)
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
