"""Measure the package room by room, and compare the measures with their budget.

    python tools/house.py            # the table; exits with 1 if a budget is exceeded
    python tools/house.py --lower    # lowers the budget to the measured values

A room is a folder of ``src/tominpmp``, or all of its loose modules together. Its code
lines are lines with a token other than a comment or a docstring. Tuned numbers are
constants of modules that plan motions: numbers assigned to a name in capitals. The
budget is ``tools/house.toml``. It is lowered with each change that saves lines, and
raised only with a reason in the message of the change.
"""

from __future__ import annotations

import argparse
import ast
import io
import sys
import tokenize
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "tominpmp"
BUDGET = ROOT / "tools" / "house.toml"
LOOSE = "modules"
# Rooms whose constants influence the planned motion.
TUNED_ROOMS = ("planner", "solvers", "transcription", "initial_guess")
NO_CODE = {
    tokenize.COMMENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
    tokenize.INDENT,
    tokenize.NEWLINE,
    tokenize.NL,
}
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass
class Room:
    """Measures of a room.

    Attributes:
        files: Number of its modules.
        code: Code lines.
        tuned: Tuned numbers; 0 in rooms that plan no motions.
    """

    files: int = 0
    code: int = 0
    tuned: int = 0


@dataclass(frozen=True)
class House:
    """Measures of the package.

    Attributes:
        rooms: By the name of the room.
        public: Number of public classes and functions of all modules.
        repeated: Names of classes that more than one module defines.
    """

    rooms: dict[str, Room]
    public: int
    repeated: list[str]

    def totals(self) -> dict[str, int]:
        """Measures of the whole package that have a budget."""
        rooms = self.rooms.values()
        return {
            "code": sum(room.code for room in rooms),
            "files": sum(room.files for room in rooms),
            "tuned_numbers": sum(room.tuned for room in rooms),
            "public_definitions": self.public,
            "repeated_class_names": len(self.repeated),
        }


def code_lines(text: str, tree: ast.Module) -> int:
    """Number of lines with code."""
    documented: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False):
            text_node = node.body[0]
            documented.update(range(text_node.lineno, text_node.end_lineno + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - documented)


def tuned_numbers(tree: ast.Module) -> int:
    """Number of numbers that a module assigns to names in capitals."""
    count = 0
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        names = [leaf for target in targets for leaf in ast.walk(target)]
        if any(isinstance(n, ast.Name) and n.id.lstrip("_").isupper() for n in names):
            count += sum(
                isinstance(leaf, ast.Constant) and type(leaf.value) in (int, float)
                for leaf in ast.walk(node.value)
            )
    return count


def measure(package: Path = PACKAGE) -> House:
    """Measure a package.

    Args:
        package: Its folder.
    """
    rooms: dict[str, Room] = {}
    classes: Counter[str] = Counter()
    public = 0
    for path in sorted(package.rglob("*.py")):
        inside = path.relative_to(package).parts
        name = inside[0] if len(inside) > 1 else LOOSE
        text = path.read_text("utf-8")
        tree = ast.parse(text, filename=str(path))
        room = rooms.setdefault(name, Room())
        room.files += 1
        room.code += code_lines(text, tree)
        room.tuned += tuned_numbers(tree) if name in TUNED_ROOMS else 0
        for node in tree.body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                public += not node.name.startswith("_")
            if isinstance(node, ast.ClassDef):
                classes[node.name] += 1
    repeated = sorted(name for name, count in classes.items() if count > 1)
    return House(rooms, public, repeated)


def excesses(house: House, budget: dict[str, Any]) -> list[str]:
    """Measures above their budget, a line each."""
    found = [
        f"room {name} has {room.code} code lines, {budget['rooms'].get(name, 0)} at "
        "the most"
        for name, room in house.rooms.items()
        if room.code > budget["rooms"].get(name, 0)
    ]
    return found + [
        f"{name} is {value}, {budget['total'][name]} at the most"
        for name, value in house.totals().items()
        if value > budget["total"][name]
    ]


def lowered(house: House, budget: dict[str, Any]) -> str:
    """The budget lowered to the measured values, as text of its file."""
    head = BUDGET.read_text("utf-8").split("[total]")[0]
    totals = {
        name: min(value, budget["total"][name])
        for name, value in house.totals().items()
    }
    rooms = {
        name: min(house.rooms[name].code, most)
        for name, most in sorted(budget["rooms"].items())
        if name in house.rooms
    }
    lines = [head + "[total]", *(f"{name} = {most}" for name, most in totals.items())]
    lines += ["", "[rooms]", *(f"{name} = {most}" for name, most in rooms.items())]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Print the table; exit code 1 if a measure exceeds its budget."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lower", action="store_true", help="take savings off")
    asked = parser.parse_args()
    house, budget = measure(), tomllib.loads(BUDGET.read_text("utf-8"))
    print(f"{'room':16}{'files':>7}{'code':>8}{'tuned':>7}{'budget':>8}")
    for name, room in sorted(house.rooms.items(), key=lambda item: -item[1].code):
        most = budget["rooms"].get(name, 0)
        print(f"{name:16}{room.files:7}{room.code:8}{room.tuned:7}{most:8}")
    for name, value in house.totals().items():
        print(f"{name:30}{value:8}{budget['total'][name]:8}")
    above = excesses(house, budget)
    for line in above:
        print(f"above the budget: {line}", file=sys.stderr)
    if asked.lower:
        BUDGET.write_text(lowered(house, budget), "utf-8")
    return int(bool(above))


if __name__ == "__main__":
    sys.exit(main())
