"""Build the wheel and the sdist, install them in an empty environment and try them.

The environment gets only the declared dependencies, no extras, at the versions of the
lock file. The sdist then replaces the wheel there, as both declare the same
dependencies. All commands run in another directory, so that the clone is not imported.

    python tools/check_package.py [--documents]

With --documents the wheel is installed as the first pages say, with the extras that
they name, and their blocks of Python and commands are run there.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Pages that a new user reads first, and pattern of the extras that they install.
PAGES = ("README.md", "docs/start.md", "docs/first_hour.md", "docs/index.md")
HOW_TOS = sorted(ROOT.glob("docs/how_to/*.md"))
EXTRA = re.compile(r"pip install '(?:tominpmp|\.)\[([\w,]+)\]'")

TRIAL = """
from importlib.resources import files
import tominpmp
robot = tominpmp.load_robot("planar3r")
assert robot.n == 3, robot
assert tominpmp.load_robot("panda", group="panda_arm").n == 7, "no robots by name"
assert files("tominpmp").joinpath("py.typed").is_file(), "py.typed is missing"
start, goal = [0.5, 1.7, -1.7], tominpmp.JointGoal([0.6, 1.6, -1.6])
problem = tominpmp.Problem(robot, start, goal)
page = tominpmp.plan(problem).play(path="motion.html")
assert page.stat().st_size > 10**6, "no viewer"
from tominpmp.datasheets import datasheets
assert len(datasheets()) > 10, "the data sheets are missing"
"""


def run(*command: str | Path, cwd: Path) -> None:
    """Run a command, and exit with its output if it fails.

    Args:
        command: Program and arguments.
        cwd: Directory to run in.
    """
    result = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if result.returncode:
        words = " ".join(map(str, command))
        sys.exit(f"failed: {words}\n{result.stdout}{result.stderr}")


def build(folder: Path) -> tuple[Path, Path]:
    """Build the sdist, and the wheel from the sdist; return wheel and sdist.

    Args:
        folder: Folder for both files.
    """
    options = ("--no-isolation", "--outdir", folder)
    run(sys.executable, "-m", "build", *options, ROOT, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    (sdist,) = folder.glob("*.tar.gz")
    return wheel, sdist


def write_constraints(path: Path) -> None:
    """Write the locked versions, without hashes, as the wheel itself has no hash.

    Extras are left out, too: pip takes no constraints that have them.

    Args:
        path: The file to write.
    """
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    pins = re.findall(r"^([^\s\[]+)(?:\[.+?\])?(==.+?) \\$", lock, flags=re.MULTILINE)
    path.write_text("".join(f"{name}{version}\n" for name, version in pins), "utf-8")


def try_out(binaries: Path, folder: Path) -> None:
    """Use the installed package: library, module and command.

    Args:
        binaries: Folder of the environment's programs.
        folder: Directory to run in.
    """
    run(binaries / "python", "-m", "pip", "check", cwd=folder)
    run(binaries / "python", "-c", TRIAL, cwd=folder)
    run(binaries / "python", "-m", "tominpmp", "--help", cwd=folder)
    run(binaries / "tominpmp", "--help", cwd=folder)


def extras() -> list[str]:
    """The extras that the first pages say to install."""
    text = "\n".join((ROOT / page).read_text("utf-8") for page in PAGES)
    return sorted({name for part in EXTRA.findall(text) for name in part.split(",")})


def try_documents(binaries: Path, folder: Path) -> None:
    """Run the code of the first pages and the how-tos with the installed package."""
    where = "import sys, tominpmp; assert sys.prefix in tominpmp.__file__"
    run(binaries / "python", "-c", where, cwd=folder)
    program = (binaries / "python", ROOT / "tools" / "doc_blocks.py")
    run(*program, "--commands", *(ROOT / page for page in PAGES), cwd=folder)
    run(*program, *HOW_TOS, cwd=folder)


def main() -> None:
    """Check both packages, or the documents with one of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--documents", action="store_true")
    documents = parser.parse_args().documents
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel, sdist = build(folder)
        constraints = folder / "constraints.txt"
        write_constraints(constraints)
        venv.create(folder / "venv", with_pip=True)
        binaries = folder / "venv" / "bin"
        pip = (binaries / "python", "-m", "pip", "--disable-pip-version-check")
        install = (*pip, "install", "--no-compile")

        if documents:
            given = f"{wheel}[{','.join(extras())}]"
            run(*install, "--constraint", constraints, given, cwd=folder)
            try_documents(binaries, folder)
            print(f"{Path(given).name}: the code of the documents runs")
            return
        run(*install, "--constraint", constraints, wheel, cwd=folder)
        try_out(binaries, folder)
        print(f"{wheel.name}: installs and runs")

        run(*pip, "uninstall", "--yes", "tominpmp", cwd=folder)
        run(*install, "--no-deps", sdist, cwd=folder)
        try_out(binaries, folder)
        print(f"{sdist.name}: installs and runs")


if __name__ == "__main__":
    main()
