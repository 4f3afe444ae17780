"""Motions as tables: CSV for any program, NPZ for NumPy.

The columns of a CSV file are named ``time``, ``q_<joint>``, ``v_<joint>``,
``a_<joint>`` and ``u_<joint>``, without units, so that any program accepts the names.
Motions of several segments have a last column ``segment`` with the segment numbers from
1, or an array ``segment_ends`` [s]. Numbers are written with full precision, so that
reading returns the same bits.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import zipfile
from array import array
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tominpmp.arrays import Array, to_number
from tominpmp.description.fields import Field
from tominpmp.exceptions import brief, shortened
from tominpmp.motion.samples import Samples
from tominpmp.problem.segments import MOST_SEGMENTS

QUANTITIES = ("q", "v", "a", "u")
# Most rows, more than a motion of an hour at 1 kHz has. A small archive may unpack to
# any number of zeros, and a small file may hold any number of empty rows.
MAX_ROWS = 5_000_000
# Most numbers of a file; Python objects and copies take a multiple of their memory.
MAX_NUMBERS = 2**24
# Most members of an archive, and most bytes of its names and headers.
MAX_MEMBERS, MAX_NAMES = 100, 2**20
# Longest line of a motion file [characters].
LONGEST_LINE = 2**20
# Column with the number of the segment.
SEGMENT = "segment"


def _columns(joint_names: tuple[str, ...], quantities: tuple[str, ...]) -> list[str]:
    return ["time", *(f"{key}_{name}" for key in quantities for name in joint_names)]


def known_quantities(samples: Samples) -> tuple[str, ...]:
    """Quantities of which samples have values."""
    each = ((key, getattr(samples, key)) for key in QUANTITIES)
    return tuple(k for k, x in each if k == "q" or not np.all(np.isnan(x)))


def write_csv(samples: Samples, file: BinaryIO) -> None:
    """Write samples as CSV."""
    quantities = known_quantities(samples)
    header = _columns(samples.joint_names, quantities)
    parts = [getattr(samples, key) for key in quantities]
    rows = np.column_stack([samples.t, *parts]).tolist()
    if samples.segment_ends is not None:
        header.append(SEGMENT)
        for row, number in zip(rows, samples.segment_numbers.tolist(), strict=True):
            row.append(number)
    text = codecs.getwriter("utf-8")(file)
    csv.writer(text, lineterminator="\n").writerows([header, *rows])


def write_npz(samples: Samples, file: BinaryIO) -> None:
    """Write samples as NPZ."""
    arrays: dict[str, Any] = {"joint_names": np.array(samples.joint_names)}
    arrays |= {key: getattr(samples, key) for key in ("t", *known_quantities(samples))}
    if samples.segment_ends is not None:
        arrays["segment_ends"] = samples.segment_ends
    np.savez(file, **arrays)


def read_csv(content: bytes, path: Path) -> Samples:
    """Read samples from CSV.

    Raises:
        ScenarioError: If it is not a valid table; names the line and the column.
    """
    # Reading line by line: a whole table of texts takes ten times its memory.
    text = io.TextIOWrapper(io.BytesIO(content), "utf-8-sig", newline="")
    file = Field(None, path)
    lines = csv.reader(_short_lines(text, file), strict=True)
    try:
        header = next(lines, [])
        numbered = header[-1:] == [SEGMENT]
        joint_names, quantities = _header(header[:-1] if numbered else header, file)
        table = _table(lines, header, file)
    except (UnicodeDecodeError, csv.Error) as error:
        file.fail(f"is not a CSV file: {error}")
    n = len(joint_names)
    parts = {
        key: table[:, 1 + i * n : 1 + (i + 1) * n] for i, key in enumerate(quantities)
    }
    ends = _segment_ends(table, file) if numbered and len(table) else None
    return filled_samples(joint_names, table[:, 0], parts, segment_ends=ends)


def filled_samples(
    joint_names: tuple[str, ...], t: Array, parts: Mapping[str, Array], **more: Any
) -> Samples:
    """Samples with the quantities of a file; missing quantities are NaN.

    Args:
        joint_names: Names of the n joints.
        t: Times, shape (N,) [s].
        parts: Arrays by the names in :data:`QUANTITIES`, at least "q", shape (N, n).
        **more: Further fields of the samples.
    """
    lacking = np.full(parts["q"].shape, np.nan)
    q, v, a, u = (parts.get(key, lacking) for key in QUANTITIES)
    return Samples(joint_names, t, q, v, a, u, **more)


def _segment_ends(table: Array, file: Field) -> Array:
    """Times of the first row of each segment but the first, and of the last row [s]."""
    # A segment that takes no time has no row of its own.
    step = np.diff(table[:, -1], prepend=1.0)
    wrong = np.flatnonzero(~((step >= 0.0) & (step < MOST_SEGMENTS) & (step % 1 == 0)))
    if wrong.size:
        row = int(wrong[0])
        file.get(SEGMENT).fail(
            f"is {table[row, -1]:g} in row {row + 1}, expected whole numbers from 1 "
            "that do not decrease"
        )
    return np.append(np.repeat(table[:, 0], step.astype(np.int64)), table[-1, 0])


def _short_lines(text: io.TextIOWrapper, file: Field) -> Iterator[str]:
    """Lines of a file; raises an error if they are too long or too many."""
    number = 0
    while line := text.readline(LONGEST_LINE):
        number += 1
        if len(line) == LONGEST_LINE or number > MAX_ROWS + 1:
            most = f"{LONGEST_LINE} characters in a line, or {MAX_ROWS} rows"
            file.fail(f"line {number}: more than {most}")
        yield line


def _table(lines: Iterator[list[str]], header: list[str], file: Field) -> Array:
    """Numbers below the header, one row per line, shape (N, columns)."""
    numbers = array("d")
    for number, line in enumerate(lines, start=2):
        if not line:
            continue
        if len(line) != len(header):
            counts = f"{len(line)} values for {len(header)} columns"
            file.fail(f"line {number}: {counts}")
        if len(numbers) + len(line) > MAX_NUMBERS:
            file.fail(f"holds more than {MAX_NUMBERS} numbers")
        for column, word in zip(header, line, strict=True):
            try:
                numbers.append(to_number(word))
            except ValueError:
                file.get(column).fail(f"{brief(word)} in line {number} is not a number")
    return np.array(numbers).reshape(-1, len(header))


def _header(header: list[str], file: Field) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Joint names and quantities of the columns."""
    names = tuple(column[2:] for column in header if column.startswith("q_"))
    kinds = tuple(key for key in QUANTITIES if names and f"{key}_{names[0]}" in header)
    if names and header == _columns(names, kinds):
        return names, kinds
    file.fail(
        f"line 1: expected the columns time, q_<joint>, ..., v_<joint>, ..., "
        "a_<joint>, ..., u_<joint>, ... with commas between them (the last three "
        f"kinds may be left out; a column {SEGMENT} may follow), found: "
        f"{shortened(repr(', '.join(header)), 200)}"
    )


def read_npz(content: bytes, path: Path) -> Samples:
    """Read samples from NPZ.

    Raises:
        ScenarioError: If it is not a valid archive; names the array.
    """
    keys, file = ("joint_names", "t", *QUANTITIES, "segment_ends"), Field(None, path)
    try:
        if content.count(b"PK\x01\x02") > MAX_MEMBERS:
            raise ValueError(f"it has more than {MAX_MEMBERS} members")
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = [name.removesuffix(".npy") for name in archive.namelist()]
            arrays = {key: _array(archive, key) for key in keys if key in files}
            held = ", ".join(files)[:200] or "nothing"
    except Exception as error:  # a damaged archive may raise anything
        file.fail(f"is not an NPZ file: {shortened(str(error), 300)}")
    for key in ("joint_names", "t", "q"):
        if key not in arrays:
            file.get(key).fail(f"is missing; the file holds: {held}")
    names = arrays.pop("joint_names")
    if names.ndim != 1 or names.dtype.kind != "U":
        file.get("joint_names").fail("is not a list of names")
    t, ends = arrays.pop("t"), arrays.pop("segment_ends", None)
    return filled_samples(tuple(names.tolist()), t, arrays, segment_ends=ends)


def _array(archive: zipfile.ZipFile, key: str) -> np.ndarray[Any, Any]:
    """Read an array, if its size agrees with its header and is within the limits."""
    info = archive.getinfo(f"{key}.npy")
    most = MAX_NAMES if key == "joint_names" else 8 * MAX_NUMBERS // len(QUANTITIES)
    if info.file_size > most + MAX_NAMES:
        raise ValueError(f"{key} takes {info.file_size} bytes, expected {most} at most")
    form = np.lib.format
    readers = {1: form.read_array_header_1_0, 2: form.read_array_header_2_0}
    with archive.open(info) as file:
        shape, columnwise, dtype = readers[form.read_magic(file)[0]](file)
        content = file.read()
    count = math.prod(shape)
    if dtype.hasobject or count * dtype.itemsize != len(content) or not dtype.itemsize:
        raise ValueError(f"{key} says that it holds {shape} values of {dtype}")
    if count > most // 8:
        raise ValueError(f"{key} holds {count} values, expected {most // 8} at most")
    values = np.frombuffer(content, dtype)
    return values.reshape(shape, order="F" if columnwise else "C")
