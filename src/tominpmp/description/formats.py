"""Robot files in any supported format, URDF, xacro or MJCF, recognised by content."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tominpmp.checks import wrong
from tominpmp.description.mjcf import describe_mjcf
from tominpmp.description.paths import read_bytes
from tominpmp.description.srdf import SemanticDescription
from tominpmp.description.tree import UrdfDescription
from tominpmp.description.urdf import read_urdf
from tominpmp.description.xacro_files import expanded, is_xacro
from tominpmp.description.xml_reader import MAX_BYTES, parse_xml
from tominpmp.exceptions import OptionsError, RobotLoadError


def read_description(
    path: Path,
    package_dirs: Sequence[Path],
    text: bytes | None = None,
    xacro_args: Mapping[str, object] | None = None,
) -> tuple[UrdfDescription, SemanticDescription | None, Mapping[str, Any]]:
    """Read the description of a robot from a file or a text.

    Args:
        path: The file, or a name for the text.
        package_dirs: Folders in which packages are searched.
        text: Content, in place of that of the file.
        xacro_args: Values of the arguments of a xacro file.

    Returns:
        The same as :func:`~tominpmp.description.from_pinocchio.describe_model`.

    Raises:
        RobotLoadError: If it cannot be read.
        OptionsError: If the file does not declare such an argument.
        MissingDependency: If it is a xacro file and xacrodoc is not installed.
    """
    args = {} if xacro_args is None else xacro_args
    if not isinstance(args, Mapping):
        raise wrong(args, "xacro_args", "values by name", OptionsError)
    text = read_bytes(path, MAX_BYTES, RobotLoadError) if text is None else text
    root = parse_xml(text, path)
    if is_xacro(root):
        root = parse_xml(expanded(text, path, package_dirs, args), path)
    elif args:
        message = f"{path} is no xacro file: it has no arguments"
        raise OptionsError(message, "xacro_args")
    if root.tag == "mujoco":
        return describe_mjcf(root, path, package_dirs)
    description = read_urdf(path, package_dirs, root)
    return replace(description, xacro_args=tuple(args.items())), None, {}
