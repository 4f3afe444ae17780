"""Run the Python of a page of documentation, block after block, in one namespace.

    python tools/doc_blocks.py [--slow] [--commands] [PAGE ...]

A page is Markdown. Its blocks are fences of Python, and cells of notebooks. HTML
comments, which are not displayed, set how blocks are run:

    <!-- before          lines of Python up to the closing arrow are run, too
    <!-- slow -->        the next block runs with --slow only, as in `make docs`
    <!-- needs NAME -->  the next block is left out if the module NAME is missing
    <!-- left out: WHY -->   the next block is not run

With --commands, lines of a page that call the command `tominpmp` in indented code are
run after its blocks, in the same folder, which also contains the examples; the pages
are then named, as many have commands with parts left out, or that never end.

Without pages, the blocks of README.md and of all docs are run.
"""

from __future__ import annotations

import argparse
import ast
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(
    r"^(?P<mark>```+)(?:python|\{code-cell\}[^\n]*)\n(?P<code>.*?)^(?P=mark)[ ]*$"
    r"|^<!-- before\n(?P<hidden>.*?)^-->"
    r"|^<!-- (?P<rule>slow|needs \w+|left out: [^\n]*) -->$",
    re.MULTILINE | re.DOTALL,
)
# A command, indented, on as many lines as it takes.
COMMAND = re.compile(r"^ {4}(tominpmp (?:.*\\\n)*.*)$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of a page.

    Attributes:
        page: The page.
        line: Line number of its first line in the page, from 1.
        code: The code.
        rule: Rule of its comment; empty if the block is always run.
    """

    page: Path
    line: int
    code: str
    rule: str = ""

    def left_out(self, slow: bool) -> bool:
        """Whether the block is not run."""
        kind, _, rest = self.rule.partition(" ")
        if kind == "needs":
            return find_spec(rest) is None
        return kind == "left" or (kind == "slow" and not slow)

    def run(self, names: dict[str, Any]) -> None:
        """Run the block; errors refer to the page and its line."""
        # Options of a MyST cell precede its code.
        code = re.sub(r"^:[\w-]+:.*$", "", self.code, flags=re.MULTILINE)
        tree = ast.parse("\n" * (self.line - 1) + code, filename=str(self.page))
        exec(compile(tree, str(self.page), "exec"), names)


def pages() -> list[Path]:
    """README and all pages, in order."""
    docs = ROOT / "docs"
    found = [path for path in docs.rglob("*.md") if docs / "build" not in path.parents]
    return [ROOT / "README.md", *sorted(found)]


def blocks(page: Path) -> Iterator[Block]:
    """The blocks of a page."""
    text, rule = page.read_text("utf-8"), ""
    for found in FENCE.finditer(text):
        if found["rule"]:
            rule = found["rule"]
            continue
        part = "hidden" if found["hidden"] is not None else "code"
        line = text.count("\n", 0, found.start(part)) + 1
        yield Block(page, line, found[part], rule if part == "code" else "")
        rule = rule if part == "hidden" else ""


def commands(page: Path) -> Iterator[list[str]]:
    """The commands of a page, as words."""
    for found in COMMAND.findall(page.read_text("utf-8")):
        yield shlex.split(found.replace("\\\n", " "), comments=True)


def run_commands(page: Path, folder: Path) -> int:
    """Run the commands of a page in a folder with this environment's program.

    Returns:
        Number of commands.

    Raises:
        RuntimeError: If a command fails, with its output.
    """
    shutil.copytree(ROOT / "examples", folder / "examples", dirs_exist_ok=True)
    count = 0
    for _, *arguments in commands(page):
        program = [sys.executable, "-m", "tominpmp", *arguments]
        found = subprocess.run(program, cwd=folder, capture_output=True, text=True)
        if found.returncode:
            words = shlex.join(["tominpmp", *arguments])
            raise RuntimeError(f"failed: {words}\n{found.stdout}{found.stderr}")
        count += 1
    return count


def run_page(page: Path, folder: Path, *, slow: bool = False) -> dict[str, Any]:
    """Run a page in a folder, with the files of docs/static.

    Args:
        page: The page.
        folder: An empty folder, the current directory during the run.
        slow: Whether to run blocks that take long, too.

    Returns:
        The names that its code has defined.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    shutil.copytree(ROOT / "docs" / "static", folder, dirs_exist_ok=True)
    before = Path.cwd()
    os.chdir(folder)
    try:
        for block in blocks(page):
            if not block.left_out(slow):
                block.run(names)
    finally:
        os.chdir(before)
    return names


def main() -> int:
    """Run pages, and report the time and the failure of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE")
    parser.add_argument("--slow", action="store_true", help="blocks marked slow, too")
    parser.add_argument("--commands", action="store_true", help="commands, too")
    arguments = parser.parse_args()
    if arguments.commands and not arguments.pages:
        parser.error("--commands needs PAGE: not every page has complete commands")
    warnings.simplefilter("error")
    # From the event loop of the viewer's server, and from strings in TOPP-RA.
    warnings.filterwarnings("ignore", "zmq.eventloop.ioloop is deprecated")
    warnings.filterwarnings("ignore", "invalid escape sequence")
    failed = [
        page
        for page in arguments.pages or pages()
        if not tell_of(
            page.resolve(), slow=arguments.slow, with_commands=arguments.commands
        )
    ]
    for page in failed:
        sys.stderr.write(f"failed: {page}\n")
    return 1 if failed else 0


def tell_of(page: Path, *, slow: bool, with_commands: bool = False) -> bool:
    """Run a page, and print its time, or the cause of its failure."""
    count = len(list(blocks(page)))
    told = f"{count:2d} blocks"
    if not count and not with_commands:
        return True
    begin, said = time.process_time(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(said):
        try:
            run_page(page, Path(folder), slow=slow)
            if with_commands:
                told += f", {run_commands(page, Path(folder))} commands"
        except Exception:
            sys.stderr.write(f"{said.getvalue()}{traceback.format_exc()}")
            return False
    seconds = time.process_time() - begin
    sys.stdout.write(f"{seconds:6.1f} s  {told}  {page}\n")
    sys.stdout.flush()
    return True


if __name__ == "__main__":
    raise SystemExit(main())
