"""Values that are invalid for all arguments, or for most of them."""

from __future__ import annotations

import datetime
import math
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np


class NoRepr:
    """An object whose ``repr`` fails."""

    def __repr__(self) -> str:
        """Fail."""
        raise RuntimeError("cannot be shown")


class Quiet:
    """An object without anything."""


def _deep() -> list[Any]:
    value: list[Any] = []
    for _ in range(60):
        value = [value]
    return value


# New values for every input: some are consumed, and all could be changed.
NONSENSE: dict[str, Callable[[], Any]] = {
    "None": lambda: None,
    "True": lambda: True,
    "False": lambda: False,
    "0": lambda: 0,
    "1": lambda: 1,
    "-1": lambda: -1,
    "5": lambda: 5,
    "10**6": lambda: 10**6,
    "10**400": lambda: 10**400,
    "-10**5000": lambda: -(10**5000),
    "0.5": lambda: 0.5,
    "1e-320": lambda: 1e-320,
    "1e300": lambda: 1e300,
    "-1e300": lambda: -1e300,
    "nan": lambda: math.nan,
    "inf": lambda: math.inf,
    "-inf": lambda: -math.inf,
    "1j": lambda: 1j,
    "text": lambda: "x",
    "empty text": lambda: "",
    "number as text": lambda: "1.0",
    "name of a joint": lambda: "joint1",
    "name of a frame": lambda: "tip",
    "long text": lambda: "x" * 1_000_000,
    "text with NUL": lambda: "a\0b",
    "lone surrogate": lambda: "\ud800.csv",
    "lines": lambda: "a\nb\n" * 1000,
    "bytes": lambda: b"x",
    "bytearray": lambda: bytearray(3),
    "home of nobody": lambda: "~nouser-at-all/x",
    "home of nobody, a path": lambda: pathlib.Path("~nouser-at-all/x.csv"),
    "name of 300 characters": lambda: "n" * 300 + ".csv",
    "path of 300 characters": lambda: pathlib.Path("n" * 300 + ".csv"),
    "folder": lambda: "/tmp",
    "folder, a path": lambda: pathlib.Path("/"),
    "file that is not there": lambda: "/nowhere/at/all.csv",
    "device": lambda: "/dev/null",
    "endless device": lambda: "/dev/zero",
    "csv": lambda: "out.csv",
    "toml": lambda: "out.toml",
    "png": lambda: "out.png",
    "html": lambda: "out.html",
    "urdf": lambda: "out.urdf",
    "path object": lambda: pathlib.Path("out.npz"),
    "[]": lambda: [],
    "()": lambda: (),
    "{}": lambda: {},
    "set": lambda: {1, 2},
    "[None] * 3": lambda: [None] * 3,
    "zeros": lambda: [0.0, 0.0, 0.0],
    "three": lambda: [0.1, 0.2, 0.3],
    "four": lambda: (0.0, 0.0, 0.0, 1.0),
    "three nan": lambda: [math.nan] * 3,
    "three inf": lambda: [math.inf] * 3,
    "three huge": lambda: [1e300] * 3,
    "integers": lambda: [10**400, 0, 0],
    "texts": lambda: ["a", "b", "c"],
    "joints": lambda: ("joint1", "joint2", "joint3"),
    "ragged": lambda: [[1.0], [2.0, 3.0]],
    "deep": _deep,
    "million": lambda: [0.0] * 1_000_000,
    "mapping": lambda: {"joint1": 1.0},
    "mapping of texts": lambda: {"joint1": "x"},
    "mapping of nobody": lambda: {"nobody": 1.0},
    "mapping by number": lambda: {1: 2.0},
    "mapping of None": lambda: {None: None},
    "range": lambda: range(3),
    "endless range": lambda: range(10**12),
    "generator": lambda: (x for x in (0.0, 1.0, 2.0)),
    "iterator": lambda: iter([1.0, 2.0, 3.0]),
    "array": lambda: np.zeros(3),
    "array of one": lambda: np.array([1.0]),
    "scalar array": lambda: np.array(1.0),
    "empty array": lambda: np.zeros((0, 3)),
    "matrix": lambda: np.eye(3),
    "identity": lambda: np.eye(4),
    "cube": lambda: np.zeros((3, 3, 3)),
    "objects": lambda: np.array([None, "x", 1.0], dtype=object),
    "complex": lambda: np.zeros(3, complex),
    "booleans": lambda: np.ones(3, bool),
    "words": lambda: np.array(["a", "b", "c"]),
    "dates": lambda: np.zeros(3, "datetime64[s]"),
    "record": lambda: np.zeros(3, [("a", "f8")]),
    "float32": lambda: np.float32(0.5),
    "long double": lambda: np.longdouble("1e4000"),
    "date": lambda: datetime.datetime(2020, 1, 1, tzinfo=datetime.timezone.utc),
    "object": Quiet,
    "object that cannot be shown": NoRepr,
    "class": lambda: Quiet,
    "function": lambda: len,
    "lambda": lambda: lambda *_: None,
    "lambda that fails": lambda: lambda *_: 1 / 0,
    "module": lambda: math,
    "ellipsis": lambda: ...,
    "slice": lambda: slice(None),
    "exception": lambda: ValueError("x"),
}
