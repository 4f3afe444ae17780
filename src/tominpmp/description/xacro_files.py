"""xacro files: expansion of macros, properties and includes to a URDF or SRDF file.

The packages xacrodoc and xacro expand them, without ROS. Packages (``$(find NAME)``)
are searched in the same folders as for meshes. Expressions in such a file are Python,
which these packages evaluate; each one is inspected first, so that it can call xacro's
own functions only. Included files are read with the same limits as others
(:mod:`~tominpmp.description.xml_reader`).
"""

from __future__ import annotations

import ast
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr
from io import StringIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from tominpmp.checks import wrong
from tominpmp.description.files import find_package
from tominpmp.description.paths import read_bytes
from tominpmp.description.xml_reader import MAX_BYTES, parse_xml
from tominpmp.exceptions import (
    OptionsError,
    RobotLoadError,
    brief,
    fail_to_load,
    optional,
    shortened,
    unknown,
    warn_caller,
)

# Attributes that lead from a generator, or an error, to its stack frame.
FRAMES = ("gi_frame", "cr_frame", "ag_frame", "f_back", "tb_frame", "tb_next")
# xacro keeps global state in its modules.
_LOCK = threading.Lock()


def is_xacro(root: Element) -> bool:
    """Whether a file uses xacro."""
    return any(element.tag.startswith("xacro:") for element in root.iter())


class Arguments(dict[str, str]):
    """Values of the arguments of a robot's files; records which ones they declare.

    Args:
        given: The values by name; None for no values.

    Raises:
        OptionsError: If they are not given by name.
    """

    def __init__(self, given: Mapping[str, object] | None = None) -> None:
        given = {} if given is None else given
        if not isinstance(given, Mapping):
            raise wrong(given, "xacro_args", "values by name", OptionsError)
        # xacro writes truth values in lower case.
        words = ((k, str(v), isinstance(v, bool)) for k, v in given.items())
        super().__init__({k: v.lower() if flag else v for k, v, flag in words})
        self.declared: set[str] | None = None

    def __contains__(self, name: object) -> bool:
        """Record a name, which a file declares, as xacro looks it up."""
        self.declared = {*(self.declared or ()), str(name)}
        return super().__contains__(name)

    def check_declared(self, path: Path) -> None:
        """Check that every argument is declared by a file that was expanded.

        Args:
            path: The robot's file, for messages.

        Raises:
            OptionsError: If an argument is not declared.
        """
        for name in self.keys() - (self.declared or ()):
            known = sorted(self.declared or ())
            fault = unknown("xacro argument", name, known, "its files have")
            if self.declared is None:
                fault = "its files declare no xacro argument (<xacro:arg>)"
            raise OptionsError(f"{path}: {fault}", "xacro_args")


def expanded_root(
    path: Path, package_dirs: Sequence[Path], text: bytes | None, args: Arguments
) -> Element:
    """Root of a robot file or a text, expanded if it uses xacro.

    Args:
        path: The file, or a name for the text.
        package_dirs: Folders in which packages are searched.
        text: Content, in place of that of the file.
        args: Values of the arguments of a xacro file.

    Raises:
        RobotLoadError: If it cannot be read.
        MissingDependency: If it is a xacro file and xacrodoc is not installed.
    """
    text = read_bytes(path, MAX_BYTES, RobotLoadError) if text is None else text
    root = parse_xml(text, path)
    if is_xacro(root):
        return parse_xml(_expanded(text, path, package_dirs, args), path)
    return root


def _expanded(
    text: bytes, path: Path, package_dirs: Sequence[Path], args: Arguments
) -> bytes:
    """Expand the text of a xacro file to the text of a URDF or SRDF file.

    Args:
        text: Content of the file, already checked by :func:`parse_xml`.
        path: The file; files that it includes are relative to it.
        package_dirs: Folders in which packages are searched.
        args: Values of its ``<xacro:arg>``.

    Raises:
        RobotLoadError: If it cannot be expanded, or a package is missing.
        MissingDependency: If xacrodoc is not installed.
    """
    with optional("xacrodoc", "xacro", f"{path} is a xacro file; expanding it"):
        import xacro
        import xacrodoc
    printed = StringIO()
    try:
        with _LOCK, _guarded(path, package_dirs), redirect_stderr(printed):
            xacro.init_stacks(str(path.absolute()))
            document = xacrodoc.XacroDoc.from_string(
                text.decode("utf-8-sig"), subargs=args, resolve_packages=False
            )
            content: bytes = document.dom.toxml(encoding="utf-8")
    except Exception as error:  # expressions may raise anything
        raise _unwrapped_error(error, path) from error
    # xacro repeats its warnings for each use of a macro.
    if lines := dict.fromkeys(printed.getvalue().splitlines()):
        warn_caller(f"{path}: {'; '.join(lines)}")
    return content


def _unwrapped_error(error: Any, path: Path) -> RobotLoadError:
    """Error for a file that cannot be expanded; unwraps the exceptions of xacro."""
    reason = str(error) or type(error).__name__
    while getattr(error, "exc", None) is not None:
        error = error.exc
    if isinstance(error, RobotLoadError):
        return error
    if type(error).__name__ == "ArgException":
        reason = f"the argument {str(error)!r} has no value; give it one in xacro_args"
    reason = " ".join(reason.split())
    return RobotLoadError(f"{path}: xacro: {shortened(reason, 300)}", path)


@contextmanager
def _guarded(path: Path, package_dirs: Sequence[Path]) -> Iterator[None]:
    """Patch xacro to find packages here, and to refuse unsafe expressions and files."""
    import xacro
    import yaml
    from xacro import substitution_args

    parse, symbols = xacro.parse, xacro.create_global_symbols()

    def find(name: str) -> str:
        return str(find_package(name, path, package_dirs))

    def evaluate(source: str, names: dict[str, Any], more: Any = None) -> Any:
        tree = ast.parse(source.strip(), mode="eval")
        for node in ast.walk(tree):
            name = getattr(node, "attr", getattr(node, "id", ""))
            if name.startswith("__") or name in FRAMES:
                fail_to_load(path, f"refused: {brief(name)} in {brief(source)}")
        dict.update(names, __builtins__={})
        return eval(compile(tree, "<expression>", "eval"), names, more)

    def read(source: Any, filename: str | None = None) -> Any:
        if filename is not None and os.path.exists(filename):
            parse_xml(read_bytes(Path(filename), MAX_BYTES, RobotLoadError), path)
        return parse(source, filename)

    for name in ("type", "vars"):
        symbols["python"].pop(name)
    functions = substitution_args._eval_dict | {"find": find}
    changes: tuple[tuple[Any, str, Any], ...] = (
        (substitution_args, "_eval_find", find),
        (substitution_args, "_eval_dict", functions),
        (substitution_args, "eval", evaluate),
        (xacro, "safe_eval", evaluate),
        (xacro, "parse", read),
        (xacro, "_global_symbols", symbols),
        # xacro registers units for all YAML loaders in the process.
        (yaml.SafeLoader, "yaml_constructors", {**yaml.SafeLoader.yaml_constructors}),
    )
    with ExitStack() as stack:
        for owner, name, value in changes:
            stack.callback(setattr, owner, name, getattr(owner, name, eval))
            setattr(owner, name, value)
        yield
