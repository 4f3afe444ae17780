"""MoveIt's text format of planning scenes (``.scene``), which RViz exports.

The first line is a name. Each object has ``* NAME``, its pose (in newer files), its
number of shapes, for each shape its kind, sizes, pose and colour, and (in newer files)
its number of subframes with their names and poses; a dot ends the file. Poses are a
position and a quaternion in the order x, y, z, w. The result is a message in the form
of the YAML files.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from tominpmp.arrays import to_number
from tominpmp.description.yaml_reader import MAX_VALUES
from tominpmp.exceptions import ScenarioError, brief

# In a YAML file an asterisk is directly followed by a name.
_BEGINNING = re.compile(rb"[^\n]*\n\s*[*.](?!\S)")
_WORD = re.compile(r"\S+")
# Number of dimensions of each shape.
_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2}


def is_scene_text(content: bytes) -> bool:
    """Whether a file has this format, judged by its first lines."""
    return _BEGINNING.match(content) is not None


def parse_scene_text(content: bytes, path: Path) -> dict[str, Any]:
    """Parse a planning scene from the content of a file.

    Returns:
        A ``PlanningScene`` message with the objects of its world.

    Raises:
        ScenarioError: If the file is wrong or ends before the dot; names the line.
    """
    return _Reader(content.decode("utf-8", "replace"), path).scene()


@dataclass
class _Reader:
    """Splits a text into words, from its current position on."""

    text: str
    path: Path
    place: int = 0
    count: int = 0

    def scene(self) -> dict[str, Any]:
        name, objects = self._line(), []
        while (mark := self._word("'*' or '.'")) == "*":
            objects.append(self._object())
        if mark != ".":
            self._fail(brief(mark), "'*' before an object or '.' at the end")
        return {"name": name, "world": {"collision_objects": objects}}

    def _object(self) -> dict[str, Any]:
        item: dict[str, Any] = {"id": self._line()}
        # In older files the next line is the number of shapes, a single word.
        place, is_new = self.place, len(self._line().split()) > 1
        self.place = place
        if is_new:
            item["pose"] = self._pose()
        for _ in range(self._whole("how many shapes there are")):
            kinds, poses, shape = self._shape()
            item.setdefault(kinds, []).append(shape)
            item.setdefault(poses, []).append(self._pose())
            self._numbers(4)
        for _ in range(self._whole("how many subframes there are") if is_new else 0):
            self._word("the name of a subframe")
            self._pose()
        return item

    def _shape(self) -> tuple[str, str, dict[str, Any]]:
        """Keys of the lists of shapes and poses in a message, and the shape."""
        kind = self._word("a shape")
        if kind == "mesh":
            rows = [self._whole(f"how many {k} it has") for k in ("corners", "faces")]
            corners, faces = ([self._numbers(3) for _ in range(n)] for n in rows)
            return "meshes", "mesh_poses", {"vertices": corners, "triangles": faces}
        if kind == "plane":
            return "planes", "plane_poses", {"coef": self._numbers(4)}
        if kind not in _SIZES:
            self._fail(brief(kind), f"mesh, plane, {', '.join(_SIZES)}")
        sizes = self._numbers(_SIZES[kind])
        # This format has the radius first, a message the length.
        shape = {"type": kind, "dimensions": sizes if kind == "box" else sizes[::-1]}
        return "primitives", "primitive_poses", shape

    def _pose(self) -> dict[str, list[float]]:
        return {"position": self._numbers(3), "orientation": self._numbers(4)}

    def _numbers(self, count: int) -> list[float]:
        words = [self._word("a number") for _ in range(count)]
        try:
            return [to_number(word) for word in words]
        except ValueError:
            self._fail(brief(" ".join(words)), f"{count} numbers")

    def _whole(self, expected: str) -> int:
        word = self._word(expected)
        if not (word.isascii() and word.isdigit() and len(word) < 10):
            self._fail(brief(word), expected)
        return int(word)

    def _line(self) -> str:
        """Rest of the current line."""
        begin, end = self.place, self.text.find("\n", self.place)
        self.place = len(self.text) if end < 0 else end + 1
        return self.text[begin : self.place].strip()

    def _word(self, expected: str) -> str:
        match = _WORD.search(self.text, self.place)
        self.count += 1
        if match is None or self.count > MAX_VALUES:
            self._fail("the end" if match is None else f"{MAX_VALUES} words", expected)
        self.place = match.end()
        return match[0]

    def _fail(self, found: str, expected: str) -> NoReturn:
        line = self.text.count("\n", 0, self.place) + 1
        text = f"{self.path}, line {line}: found {found}, expected {expected}"
        raise ScenarioError(text, self.path)
