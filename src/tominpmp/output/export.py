"""Motions as files: CSV for everybody, NPZ for NumPy, YAML and JSON for ROS.

All hold one row a time: the time [s], then for every joint its position [rad or m],
velocity [rad/s or m/s], acceleration [rad/s^2 or m/s^2] and torque [N m or N]. The
columns of a CSV file are named ``time``, ``q_<joint>``, ``v_<joint>``, ``a_<joint>``
and ``u_<joint>``, without units, so that any program takes the names as they are. YAML
and JSON files are messages ``JointTrajectory`` of ROS 2, see
:mod:`~tominpmp.output.ros`. Numbers are written in full: what is read back is what was
there, to the last bit; only the times of ROS messages are whole nanoseconds.
"""

from __future__ import annotations

import csv
import io
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tominpmp.arrays import Array, frozen_array
from tominpmp.description.fields import shown
from tominpmp.description.yaml_reader import read_bytes
from tominpmp.exceptions import ProblemError, ScenarioError
from tominpmp.output.files import write_file
from tominpmp.output.ros import read_json, read_yaml, write_json, write_yaml
from tominpmp.trajectory import Samples, Trajectory

QUANTITIES = ("q", "v", "a", "u")
# Motions of an hour at 1 kHz fit in.
MAX_BYTES = 2**30
# And so do their arrays: a small archive may hold any number of zeros.
MAX_ARRAY = 2**28


def export(
    trajectory: Trajectory, path: str | Path, *, dt: float | None = None
) -> Path:
    """Write a motion as CSV, NPZ or ROS message, by the ending of the path.

    A file that exists is replaced once the new one is complete.

    Args:
        trajectory: The motion.
        path: File to write, ending in ``.csv``, ``.npz``, ``.yaml`` or ``.json``.
        dt: Time between rows [s], the end of the motion being the last row in any case;
            None writes the nodes. At a node where acceleration or torque jump, the row
            holds the value just after it.

    Returns:
        The path.

    Raises:
        ProblemError: If the ending is unknown or dt is not a positive number.
        ScenarioError: If the file cannot be written.
    """
    write = _chosen(WRITERS, path)
    samples = _node_samples(trajectory) if dt is None else trajectory.sample(dt)
    return write_file(path, lambda file: write(samples, file))


def load_motion(path: str | Path) -> Samples:
    """Read a motion that :func:`export` wrote, or another program in one of its forms.

    Positions must be there; velocities, accelerations and torques need not.

    Args:
        path: CSV, NPZ, YAML or JSON file, by its ending.

    Returns:
        The samples, their times increasing; a quantity that the file lacks is NaN.

    Raises:
        ProblemError: If the ending is unknown.
        ScenarioError: If the file cannot be read or is wrong: the message says where.
    """
    read = _chosen(READERS, path)
    path = Path(path)
    try:
        return _checked(read(read_bytes(path, MAX_BYTES), path), path)
    except ProblemError as error:  # what the file holds is not samples
        raise ScenarioError(f"{path}: {error}", path, error.field) from error


def _chosen(table: dict[str, Callable], path: str | Path) -> Callable:  # type: ignore[type-arg]
    ending = Path(path).suffix.lower()
    if ending not in table:
        raise ProblemError(
            f"{path}: motions are not kept as {ending or 'files without ending'}; "
            f"there are: {', '.join(table)}",
            "path",
        )
    return table[ending]


def _node_samples(trajectory: Trajectory) -> Samples:
    return Samples(
        trajectory.joint_names,
        trajectory.t,
        trajectory.q,
        trajectory.v,
        trajectory(trajectory.t).a,
        trajectory.u,
    )


def _columns(joint_names: tuple[str, ...], quantities: tuple[str, ...]) -> list[str]:
    return ["time", *(f"{key}_{name}" for key in quantities for name in joint_names)]


def _write_csv(samples: Samples, file: BinaryIO) -> None:
    rows = np.column_stack([samples.t, samples.q, samples.v, samples.a, samples.u])
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_columns(samples.joint_names, QUANTITIES))
    writer.writerows([repr(value) for value in row] for row in rows.tolist())
    text.flush()
    text.detach()  # the file is closed by whoever opened it


def _write_npz(samples: Samples, file: BinaryIO) -> None:
    np.savez(
        file,
        joint_names=np.array(samples.joint_names),
        t=samples.t,
        q=samples.q,
        v=samples.v,
        a=samples.a,
        u=samples.u,
    )


def _read_csv(content: bytes, path: Path) -> Samples:
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
    return Samples(joint_names, table[:, 0], **parts)


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


def _read_npz(content: bytes, path: Path) -> Samples:
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
    return Samples(tuple(names.tolist()), **arrays)


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


def _checked(samples: Samples, path: Path) -> Samples:
    """Check shapes and values, and make the arrays read-only."""
    names, n = samples.joint_names, len(samples.joint_names)
    if n == 0 or len(set(names)) < n or "" in names:
        raise ScenarioError(
            f"{path}: the joints need names, each its own, not {', '.join(names)}",
            path,
            "joint_names",
        )
    rows = samples.t.size
    shapes = {"t": (rows,)} | {key: (rows, n) for key in QUANTITIES}
    arrays = {}
    for key, shape in shapes.items():
        values = getattr(samples, key)
        if values.shape != shape:
            raise ScenarioError(
                f"{path}: {key} has shape {values.shape}, expected {shape}", path, key
            )
        wrong = np.argwhere(~np.isfinite(values))
        if len(wrong) and not _left_out(key, values):
            where = f"row {wrong[0][0] + 1}"
            if key != "t":
                where += f", joint {names[wrong[0][1]]!r}"
            raise ScenarioError(
                f"{path}: {key} is not a finite number in {where}", path, key
            )
        arrays[key] = frozen_array(values)
    if rows < 2:
        raise ScenarioError(f"{path} holds {rows} rows, expected 2 or more", path)
    back = np.flatnonzero(np.diff(arrays["t"]) <= 0.0)
    if back.size:
        k = int(back[0])
        raise ScenarioError(
            f"{path}: the time must increase, but is {arrays['t'][k]} s in row {k + 1} "
            f"and {arrays['t'][k + 1]} s in the next",
            path,
            "time",
        )
    return Samples(names, **arrays)


def _left_out(key: str, values: Array) -> bool:
    """Whether nothing is said about a quantity, which positions and times need."""
    return key not in ("t", "q") and bool(np.all(np.isnan(values)))


WRITERS = {
    ".csv": _write_csv,
    ".npz": _write_npz,
    ".yaml": write_yaml,
    ".yml": write_yaml,
    ".json": write_json,
}
READERS = {
    ".csv": _read_csv,
    ".npz": _read_npz,
    ".yaml": read_yaml,
    ".yml": read_yaml,
    ".json": read_json,
}
