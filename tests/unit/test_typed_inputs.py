"""What type checkers are told of constructors is what the constructors take."""

from __future__ import annotations

import ast
import inspect
import re
from dataclasses import is_dataclass
from pathlib import Path

import pytest

import tominpmp as tm
from tominpmp.scene.obstacles import Placed
from tools.type_check_documents import readme_module

RECORDS = [
    name
    for name in tm.__all__
    if inspect.isclass(getattr(tm, name)) and is_dataclass(getattr(tm, name))
]


def told(kind: type) -> ast.FunctionDef | None:
    """The constructor that only type checkers see."""
    tree = ast.parse(Path(inspect.getfile(kind)).read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name == kind.__name__:
            for part in node.body:
                if isinstance(part, ast.If) and ast.unparse(part.test) == (
                    "TYPE_CHECKING"
                ):
                    return next(x for x in part.body if isinstance(x, ast.FunctionDef))
    return None


@pytest.mark.parametrize("name", RECORDS)
def test_constructors_are_as_they_are_told(name: str) -> None:
    kind = getattr(tm, name)
    found = told(kind)
    arguments = list(inspect.signature(kind.__init__).parameters.values())[1:]
    if found is None:
        # Arrays as they are kept would be too little to take.
        told_types = [a.annotation for a in arguments]
        bare = [re.sub(r"Converted\[.*\]", "", str(told)) for told in told_types]
        assert all("Array" not in one for one in bare) or name in KEPT
        return
    plain = [a.arg for a in found.args.args[1:]]
    # Keywords that all obstacles have are said once.
    shared = list(Placed.__annotations__) if found.args.kwarg else []
    if found.args.kwarg is not None:
        assert ast.unparse(found.args.kwarg.annotation or found) == "Unpack[Placed]"
    named = shared + [a.arg for a in found.args.kwonlyargs]
    assert plain + named == [a.name for a in arguments]
    keyword_only = [a.name for a in arguments if a.kind is a.KEYWORD_ONLY]
    assert named == keyword_only
    optional = [a.name for a in arguments if a.default is not a.empty]
    count = len(found.args.defaults)
    given = plain[len(plain) - count :] if count else []
    given += shared
    given += [
        a.arg
        for a, d in zip(found.args.kwonlyargs, found.args.kw_defaults, strict=True)
        if d is not None
    ]
    assert given == optional


# Made by the library, not by its users.
KEPT = {
    *("Certificate", "ClearanceProof", "ExportCheck", "JointLimits", "LowerBound"),
    *("MotionLimits", "Options", "Robot", "Samples", "Trajectory", "Verification"),
    *("ImprovedPlacement", "Visit"),
}


def test_the_blocks_of_a_document_are_one_module() -> None:
    text = "A\n```python\na = 1\n```\nB\n```sh\nls\n```\n```python\nb = a\n```\n"
    assert readme_module(text).endswith("a = 1\n\nb = a\n")
    with pytest.raises(SystemExit):
        readme_module("nothing")
