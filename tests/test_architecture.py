"""Rules about the code as a whole: layers, imports, dependencies, budgets."""

from __future__ import annotations

import ast
import functools
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import requires
from pathlib import Path

import tominpmp
from tominpmp.files.records import classes
from tominpmp.goals.base import Goal

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import house

PACKAGE = Path(tominpmp.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

# Heavy or optional packages, which `import tominpmp` must not import.
NOT_AT_IMPORT = {
    *("casadi", "lxml", "matplotlib", "meshcat", "ompl", "trimesh", "yourdfpy")
}

# Distributions whose name differs from that of their package.
DISTRIBUTIONS = {
    "xacro": "xacrodoc",  # which requires the package xacro
    "lazy_loader": "lazy-loader",
    "pinocchio": "pin",
    "tomli_w": "tomli-w",
    "typing_extensions": "typing-extensions",
    "umsgpack": "u-msgpack-python",
    "yaml": "pyyaml",
}
# Distributions without a package, of which files are read.
DATA = {"example-robot-data"}


def name_of(path: Path) -> str:
    """Dotted name of a module of the package."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def is_command_line(path: Path) -> bool:
    return path.relative_to(PACKAGE).parts[0] in ("__main__.py", "cli")


@functools.cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def imported_names(tree: ast.Module) -> Iterator[str]:
    """Dotted names of all modules that a module imports, inside functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def test_names_in_all_exist_and_are_unique() -> None:
    wrong = []
    for path in MODULES:
        module = importlib.import_module(name_of(path))
        names = getattr(module, "__all__", [])
        twice = len(set(names)) != len(names)
        if twice or not all(hasattr(module, name) for name in names):
            wrong.append(name_of(path))
    assert wrong == []


def test_house_measures_code_lines_and_excesses(tmp_path: Path) -> None:
    room = tmp_path / "planner"
    room.mkdir()
    text = '"""Two\nlines."""\n# A comment.\n\nPATIENCE, MOST = 3, 0.5\n\n\n'
    text += 'def first() -> int:\n    """One."""\n    return (\n        1\n    )\n'
    (room / "one.py").write_text(text)
    (tmp_path / "loose.py").write_text("class First:\n    NUMBER = 1\n")
    found = house.measure(tmp_path)
    assert found.rooms == {
        "planner": house.Room(files=1, code=5, tuned=2),
        "modules": house.Room(files=1, code=2, tuned=0),
    }
    assert (found.public, found.repeated) == (2, [])
    budget = {"rooms": {"planner": 4, "modules": 2}, "total": found.totals()}
    assert house.excesses(found, budget) == [
        "room planner has 5 code lines, 4 at the most"
    ]
    budget["total"]["tuned_numbers"] = 1
    assert len(house.excesses(found, budget)) == 2


def test_only_the_command_line_prints() -> None:
    prints = [
        f"{name_of(path)}:{node.lineno}"
        for path in MODULES
        if not is_command_line(path)
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert prints == []


def test_import_loads_no_heavy_package() -> None:
    program = "import sys, tominpmp; print(*{m.split('.')[0] for m in sys.modules})"
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = set(result.stdout.split())
    assert "tominpmp" in loaded
    assert loaded & NOT_AT_IMPORT == set()


def test_imports_follow_the_layers() -> None:
    root = Path(__file__).parents[1]
    result = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"],
        cwd=root,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_modules_do_not_import_the_package_itself() -> None:
    """Names are imported from the modules that define them, so that the layers hold."""
    from_root = [
        name_of(path)
        for path in MODULES
        if "tominpmp" in imported_names(parse(path)) and not is_command_line(path)
    ]
    assert from_root == []


# Of Python 3.11 and later; before that, tomli stands for tomllib.
STANDARD = sys.stdlib_module_names | {"tomllib", "tominpmp"}


def test_declared_dependencies_are_those_imported() -> None:
    declared = {
        re.split(r"[^\w.-]", requirement)[0]: "extra ==" in requirement
        for requirement in requires("tominpmp") or []
    }
    imported = {
        DISTRIBUTIONS.get(package, package)
        for path in MODULES
        for package in (name.split(".")[0] for name in imported_names(parse(path)))
        if package not in STANDARD
    }
    assert imported - set(declared) == set()
    always_installed = {name for name, is_extra in declared.items() if not is_extra}
    assert always_installed - imported == DATA
    sources = [path.read_text(encoding="utf-8") for path in MODULES]
    for name in DATA:
        assert any(f'Path("share", "{name}"' in text for text in sources)


CHECKERS = ("bounds", "verification")
MAKERS = (
    "exact",
    "constraints",
    "initial_guess",
    "planner",
    "solvers",
    "transcription",
)


def test_verification_imports_nothing_of_the_planner() -> None:
    makers = {f"tominpmp.{name}" for name in MAKERS}
    wrong = [
        f"{name_of(path)} imports {name}"
        for path in MODULES
        if path.relative_to(PACKAGE).parts[0] in CHECKERS
        for name in imported_names(parse(path))
        if ".".join(name.split(".")[:2]) in makers
    ]
    assert wrong == []


def test_listed_packages_exist() -> None:
    for name in CHECKERS + MAKERS:
        assert (PACKAGE / name / "__init__.py").exists()


SOURCE = Path(tominpmp.__file__).parent
# A solution exports itself, and its exported file is checked against the solution.
CYCLES = {
    frozenset(("tominpmp.files.export_check", "tominpmp.solution")),
    frozenset(("tominpmp.sensitivities.records", "tominpmp.viz.plots")),
}


def imported_modules(name: str, known: set[str]) -> set[str]:
    """Modules of the library that a module imports anywhere, for types too."""
    path = SOURCE / Path(*name.split(".")[1:])
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
            "tominpmp"
        ):
            for item in node.names:
                longer = f"{node.module}.{item.name}"
                found.add(longer if longer in known else str(node.module))
    return found & known - {"tominpmp"}


def test_modules_have_no_import_cycles() -> None:
    names = {
        ".".join(("tominpmp", *file.relative_to(SOURCE).with_suffix("").parts))
        for file in SOURCE.rglob("*.py")
    }
    names = {name.removesuffix(".__init__") for name in names}
    links = {name: imported_modules(name, names) for name in names - {"tominpmp"}}
    reached: dict[str, set[str]] = {}
    for name in links:
        seen, waiting = set(), [name]
        while waiting:
            for other in links.get(waiting.pop(), ()):
                if other not in seen:
                    seen.add(other)
                    waiting.append(other)
        reached[name] = seen
    cycles = {
        frozenset(b for b in seen if name in reached.get(b, ()))
        for name, seen in reached.items()
        if name in seen
    }
    assert cycles <= CYCLES


# The largest number of modules from tm.plan down to a module without imports.
LONGEST_CHAIN = 20


def library_imports(path: Path) -> set[tuple[str, str]]:
    """Modules and names that a module imports from the library at run time.

    Imports inside functions, and for types alone, are left out.
    """
    return {
        (node.module, item.name)
        for node in parse(path).body
        if isinstance(node, ast.ImportFrom) and node.module
        if node.module.startswith("tominpmp")
        for item in node.names
    }


def test_names_are_imported_from_their_defining_module() -> None:
    """Names that a package re-exports are for callers."""
    files = {name_of(path): path for path in MODULES}
    packages = {name for name, path in files.items() if path.name == "__init__.py"}
    packages -= {"tominpmp.cli", "tominpmp.datasheets"}  # they define their names
    handed = {
        f"{name} imports {module}.{item}"
        for name, path in files.items()
        for module, item in library_imports(path)
        if name in packages or (module in packages and f"{module}.{item}" not in files)
    }
    assert handed == set()


def test_longest_import_chain_of_the_planner_is_bounded() -> None:
    """A reader of the planner follows at most this number of modules downwards."""
    files = {name_of(path): path for path in MODULES}

    @functools.cache
    def height(name: str) -> int:
        found = library_imports(files[name])
        below = {f"{m}.{item}" if f"{m}.{item}" in files else m for m, item in found}
        return 1 + max(map(height, below), default=0)

    assert height("tominpmp.planner.planning") <= LONGEST_CHAIN


def test_benchmarks_import_each_other_from_their_package() -> None:
    scripts = sorted(Path(__file__).parents[1].glob("benchmarks/*.py"))
    names = {path.stem for path in scripts}
    wrong = [
        f"{path.name} imports {name}, which `python -m` does not find"
        for path in scripts
        for name in names.intersection(imported_names(parse(path)))
    ]
    assert wrong == []


def goal_classes() -> set[str]:
    """The names of all goal classes except their base."""
    assert classes(Goal)  # imports every module with goals
    found: set[str] = set()
    waiting: list[type] = [Goal]
    while waiting:
        children = waiting.pop().__subclasses__()
        found |= {item.__name__ for item in children}
        waiting += children
    return found


def test_only_the_goals_package_distinguishes_goal_types() -> None:
    """Otherwise a new type of goal would need changes elsewhere."""
    kinds = goal_classes()
    type_checks = [
        f"{name_of(path)}:{node.lineno}"
        for path in MODULES
        if path.parent.name != "goals"
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in ("isinstance", "issubclass", "type")
        and kinds & {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    ]
    assert type_checks == []
