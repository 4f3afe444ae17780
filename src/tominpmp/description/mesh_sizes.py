"""How large the shapes of a mesh file become, which may show one of them many times.

A file of two kilobytes may hold a tree of which each branch is the one before it twice,
or say that it has an array of a billion zeros.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tominpmp.description.xml_reader import parse_xml

# Endings of files that may show a shape more than once.
MAY_REPEAT = (".dae", ".glb", ".gltf")
# What showing a shape takes beside the shape, and a number of one [bytes].
INSTANCE = 2000
NUMBER = 16
# What shapes may take beside twice the size of their file [bytes].
MAX_EXPANDED = 50_000_000


def check_expanded(path: Path, data: bytes) -> None:
    """Check that the shapes of a mesh file, each as often as it is shown, take little.

    Raises:
        ValueError: If they take much more than the file.
        Exception: Of any kind, if the file is not what its name says.
    """
    suffix = path.suffix.lower()
    size = 0.0
    if suffix == ".dae":
        size = _collada_size(parse_xml(data, path))
    elif suffix == ".glb":
        (length,) = struct.unpack("<I", data[12:16])
        size = _gltf_size(json.loads(data[20 : 20 + length]), path)
    elif suffix == ".gltf":
        size = _gltf_size(json.loads(data), path)
    most = MAX_EXPANDED + 2 * len(data)
    if size > most:
        raise ValueError(
            f"{path.name} says in {len(data)} bytes that it holds shapes of {size:g}, "
            f"more than {most}"
        )


def _gltf_size(document: Mapping[str, Any], path: Path) -> float:
    arrays = [NUMBER * abs(found["count"]) for found in document.get("accessors", ())]
    meshes = [
        INSTANCE
        + sum(
            arrays[index]
            for primitive in mesh["primitives"]
            for index in (*primitive["attributes"].values(), primitive.get("indices"))
            if index is not None
        )
        for mesh in document.get("meshes", ())
    ]
    shown = [
        meshes[node["mesh"]] for node in document.get("nodes", ()) if "mesh" in node
    ]
    names = [buffer.get("uri", "data:") for buffer in document.get("buffers", ())]
    files = [path.parent / name for name in names if not name.startswith("data:")]
    nodes = len(document.get("nodes", ()))
    beside = sum(file.stat().st_size for file in files)
    return float(sum(arrays) + sum(shown) + nodes + beside)


def _collada_size(root: Element) -> float:
    for element in root.iter():
        element.tag = element.tag.rpartition(":")[2]
    named = {element.get("id"): element for element in root.iter()}
    sizes: dict[Element, float] = {}

    def size(element: Element) -> float:
        """Size of what is below an element, and of what that refers to."""
        if element not in sizes:
            sizes[element] = math.inf  # what contains itself has no end
            total = len(element.text or "") + sum(map(size, element))
            if element.tag.startswith("instance"):
                shape = named.get(element.get("url", "").removeprefix("#"))
                total += INSTANCE + (0.0 if shape is None else size(shape))
            sizes[element] = total
        return sizes[element]

    return sum(map(size, root.findall("scene")))
