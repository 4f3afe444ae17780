"""Motions as tables: CSV for everybody, NPZ for NumPy.

The columns of a CSV file are named ``time``, ``q_<joint>``, ``v_<joint>``,
``a_<joint>`` and ``u_<joint>``, without units, so that any program takes the names as
they are. Numbers are written in full: what is read back is what was there, to the last
bit.
"""

from __future__ import annotations

import csv
import io
import math
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tominpmp.description.fields import shown
from tominpmp.exceptions import ScenarioError
from tominpmp.trajectory import Samples

QUANTITIES = ("q", "v", "a", "u")
# Arrays of motions of an hour at 1 kHz fit in; a small archive may hold any number of
# zeros.
MAX_ARRAY = 2**28


def _columns(joint_names: tuple[str, ...], quantities: tuple[str, ...]) -> list[str]:
    return ["time", *(f"{key}_{name}" for key in quantities for name in joint_names)]


def write_csv(samples: Samples, file: BinaryIO) -> None:
    """Write samples as CSV."""
    rows = np.column_stack([samples.t, samples.q, samples.v, samples.a, samples.u])
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_columns(samples.joint_names, QUANTITIES))
    writer.writerows([repr(value) for value in row] for row in rows.tolist())
    text.flush()
    text.detach()  # the file is closed by whoever opened it


def write_npz(samples: Samples, file: BinaryIO) -> None:
    """Write samples as NPZ."""
    np.savez(
        file,
        joint_names=np.array(samples.joint_names),
        t=samples.t,
        q=samples.q,
        v=samples.v,
        a=samples.a,
        u=samples.u,
    )


def read_csv(content: bytes, path: Path) -> Samples:
    """Read samples from CSV.

    Raises:
        ScenarioError: If it is none, with line and column.
    """
    try:
        text = content.decode("utf-8-sig")
        lines = list(csv.reader(io.StringIO(text), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(f"{path} is no CSV file: {error}", path) from error
    header = lines[0] if lines else []
    joint_names, quantities = _header(header, path)
    rows = [
        _numbers(line, number, header, path)
        for number, line in enumerate(lines[1:], start=2)
        if line
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, len(header))
    n = len(joint_names)
    parts = dict.fromkeys(QUANTITIES, np.full((len(table), n), np.nan))
    for i, key in enumerate(quantities):
        parts[key] = table[:, 1 + i * n : 1 + (i + 1) * n]
    q, v, a, u = (parts[key] for key in QUANTITIES)
    return Samples(joint_names, table[:, 0], q, v, a, u)


def _header(header: list[str], path: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Joints and quantities of which the columns are."""
    kinds = ("qvau", "qva", "qvu", "qau", "qv", "qa", "qu", "q")
    for quantities in kinds if header[:1] == ["time"] else ():
        n, left = divmod(len(header) - 1, len(quantities))
        names = tuple(column.removeprefix("q_") for column in header[1 : n + 1])
        if n > 0 and not left and header == _columns(names, tuple(quantities)):
            return names, tuple(quantities)
    raise ScenarioError(
        f"{path}, line 1: expected the columns time, q_<joint>, ..., v_<joint>, "
        "..., a_<joint>, ..., u_<joint>, ... (the last three kinds may be left out), "
        f"found: {', '.join(header)[:200] or 'none'}",
        path,
        "time" if header[:1] != ["time"] else None,
    )


def _numbers(
    line: list[str], number: int, header: list[str], path: Path
) -> list[float]:
    if len(line) != len(header):
        raise ScenarioError(
            f"{path}, line {number}: {len(line)} values for {len(header)} columns", path
        )
    row = []
    for column, word in zip(header, line, strict=True):
        try:
            row.append(float(word))
        except ValueError as error:
            raise ScenarioError(
                f"{path}, line {number}, column {column}: {word[:40]!r} is no number",
                path,
                column,
            ) from error
    return row


def read_npz(content: bytes, path: Path) -> Samples:
    """Read samples from NPZ.

    Raises:
        ScenarioError: If it is none, with the array.
    """
    keys = ("joint_names", "t", *QUANTITIES)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = [name.removesuffix(".npy") for name in archive.namelist()]
            arrays = {key: _array(archive, key) for key in keys if key in files}
            held = ", ".join(files)[:200] or "nothing"
    except Exception as error:  # a damaged archive may raise anything
        why = shown(str(error), 300)
        raise ScenarioError(f"{path} is no NPZ file: {why}", path) from error
    missing = [key for key in ("joint_names", "t", "q") if key not in arrays]
    if missing:
        raise ScenarioError(
            f"{path} lacks {', '.join(missing)}; it holds: {held}", path, missing[0]
        )
    names = arrays.pop("joint_names")
    if names.ndim != 1 or names.dtype.kind != "U":
        raise ScenarioError(
            f"{path}: joint_names is not a list of names", path, "joint_names"
        )
    for key, values in arrays.items():
        if values.dtype.kind not in "fiu":
            raise ScenarioError(f"{path}: {key} does not hold numbers", path, key)
    for key in QUANTITIES:
        arrays.setdefault(key, np.full(arrays["q"].shape, np.nan))
    t, q, v, a, u = (arrays[key] for key in ("t", *QUANTITIES))
    return Samples(tuple(names.tolist()), t, q, v, a, u)


def _array(archive: zipfile.ZipFile, key: str) -> np.ndarray[Any, Any]:
    """Read an array, if it is as long as it says, which may be less than it takes."""
    info = archive.getinfo(f"{key}.npy")
    if info.file_size > MAX_ARRAY:
        raise ValueError(
            f"{key} takes {info.file_size} bytes, expected {MAX_ARRAY} at most"
        )
    content = archive.read(info)
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    form = np.lib.format
    header = (
        form.read_array_header_1_0 if version[0] == 1 else form.read_array_header_2_0
    )
    shape, _, dtype = header(file)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > len(content):
        raise ValueError(f"{key} says that it holds {shape} values of {dtype}")
    array: np.ndarray[Any, Any] = form.read_array(
        io.BytesIO(content), allow_pickle=False
    )
    return array
