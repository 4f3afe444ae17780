"""Reading XML from untrusted sources, and writing it.

Robot descriptions may be downloads, so they are read in bounded time and memory:
without document types, hence without entities and remote content, and with limits on
size, depth and the number of elements. Namespaces are not resolved, because many
descriptions contain leftovers of tools (``<sensor:camera>``) without declaring a
prefix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, indent, tostring
from xml.parsers import expat

import numpy as np

from tominpmp.arrays import to_number
from tominpmp.description.paths import read_bytes
from tominpmp.exceptions import RobotLoadError, brief, fail_to_load

# The largest description of example-robot-data has 0.3 MB, 9000 elements, depth 7.
MAX_BYTES = 32 * 2**20
MAX_ELEMENTS = 500_000
MAX_DEPTH = 64

# Longest attribute, beyond any in descriptions; other parsers fail on longer ones.
MAX_TEXT = 100_000

# Endings of files that are more likely meant as scenarios than as robots.
OTHER_ENDINGS = (".yaml", ".yml", ".json", ".toml")

# Largest length, mass or inertia, beyond which numbers are mistakes, and largest limit,
# beyond which limits are infinite.
MAX_NUMBER = 1e9


def read_xml(path: Path) -> Element:
    """Read an XML file.

    Raises:
        RobotLoadError: If the file cannot be read, is too large, is not XML, or
            declares a document type.
    """
    return parse_xml(read_bytes(path, MAX_BYTES, RobotLoadError), path)


def given_text(source: object) -> bytes | None:
    """Text of an XML document given in place of a path; None if it is not one."""
    if isinstance(source, str):
        # The encoding in an XML declaration need not be that of the given text.
        source = source.lstrip("\ufeff").encode("utf-8", "replace")
    text = source.lstrip() if isinstance(source, bytes) else b""
    return text if text.startswith(b"<") else None


def parse_xml(content: bytes, path: Path) -> Element:
    """Parse XML with limits and without entities.

    Args:
        content: The document.
        path: Its source, for messages.

    Raises:
        RobotLoadError: As raised by :func:`read_xml`.
    """
    parser = expat.ParserCreate()
    builder = TreeBuilder()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise RobotLoadError(
                f"{path} has more than {MAX_ELEMENTS} elements or nests them deeper "
                f"than {MAX_DEPTH}",
                path,
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> NoReturn:
        raise RobotLoadError(
            f"{path} declares a document type (<!DOCTYPE ...>), which no description "
            "needs; remove it",
            path,
        )

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        fault = f"is not XML: {error}"
        if path.suffix.lower() in OTHER_ENDINGS:
            fault = "is not a URDF file; 'plan' and load_scenario() take TOML files"
        raise RobotLoadError(f"{path} {fault}", path) from error
    return builder.close()


@dataclass(frozen=True)
class XmlContext:
    """Reads the attributes of one file's elements, and names them in its errors.

    Attributes:
        path: The file.
        folders: Folders in which files that it refers to are searched, too.
    """

    path: Path
    folders: tuple[Path, ...] = ()

    def fail(self, message: str) -> NoReturn:
        """Raise an error about this file.

        Raises:
            RobotLoadError: Always.
        """
        fail_to_load(self.path, message)

    def text(self, element: Element, attribute: str, where: str) -> str:
        """Read a required attribute, which must not be empty."""
        value = element.get(attribute, "").strip()
        if not value:
            self.fail(f"{where}: <{element.tag}> lacks the attribute {attribute!r}")
        if len(value) > MAX_TEXT:
            self.fail(f"{where}: {element.tag} {attribute} is longer than {MAX_TEXT}")
        return value

    def numbers(
        self,
        element: Element,
        attribute: str,
        where: str,
        default: tuple[float, ...] = (0.0,),
        low: float = -MAX_NUMBER,
        most: float = MAX_NUMBER,
    ) -> tuple[float, ...]:
        """Read an attribute with as many numbers as its default, in a range.

        A missing attribute has its default. The ends of the range, ``low`` and
        ``most``, are infinite for numbers that may be infinite.
        """
        if attribute not in element.attrib:
            return default
        text, count = element.attrib[attribute], len(default)
        values = tuple(map(to_number_or_nan, text.split()))
        if len(values) != count or not all(low <= v <= most for v in values):
            wanted = "a number" if count == 1 else f"{count} numbers"
            ends = "" if math.isinf(most) else f" from {low:g} to {most:g}"
            self.fail(
                f"{where}: {element.tag} {attribute}={brief(text)}, expected "
                f"{wanted}{ends}"
            )
        return values


def to_number_or_nan(word: str) -> float:
    """Convert a word to a number; NaN if it is not a number."""
    try:
        return to_number(word)
    except ValueError:
        return math.nan


def limit_or_infinity(limit: float) -> float:
    """Replace a limit beyond reasonable sizes by infinity."""
    # "No limit" is commonly written as 1e16, or as the largest floating-point number.
    return math.copysign(math.inf, limit) if abs(limit) > MAX_NUMBER else float(limit)


def add(parent: Element, tag: str, **attributes: Any) -> Element:
    """Add an element with texts and numbers, in a notation that every parser reads."""
    element = SubElement(parent, tag)
    for name, value in attributes.items():
        numbers = () if isinstance(value, str) else np.ravel(value).tolist()
        written = " ".join(repr(float(number)) for number in numbers)
        element.set(name, value if isinstance(value, str) else written)
    return element


def xml_text(root: Element) -> bytes:
    """Content of a file with a document, one line per element."""
    indent(root)
    return b'<?xml version="1.0"?>\n' + tostring(root, encoding="unicode").encode()
