"""Judges in separate processes: their command line, and calls of them.

A judge is a program ``JUDGE.py CASE.json MOTION`` that prints its findings as JSON and
exits with 1 if it refutes the motion. It imports this module, which therefore must not
import the library.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol


class Judge(Protocol):
    """Findings on one motion.

    Attributes:
        faults: Reasons that refute it, in short sentences.
        figures: Measured values.
    """

    faults: list[str]
    figures: dict[str, float]

    def run(self) -> None:
        """Make all checks."""


def judge_named(
    usage: str | None, make: Callable[[dict[str, Any], Path], Judge]
) -> int:
    """Judge the motion named on the command line.

    Args:
        usage: Text printed if two files are not given.
        make: Makes the judge, from the case and the file of the motion.

    Returns:
        Exit code of the program.
    """
    if len(sys.argv) != 3:
        print(usage)
        return 0
    case = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    judge = make(case, Path(sys.argv[2]))
    judge.run()
    if any(name.split(".")[0] == "tominpmp" for name in sys.modules):
        raise RuntimeError("the judge has imported what it judges")
    print(json.dumps({"faults": judge.faults, **judge.figures}))
    return 1 if judge.faults else 0


def verdict_of(program: Path, case: Path, motion: Path) -> dict[str, Any]:
    """Verdict of a judge on the file of a motion.

    Args:
        program: The judge.
        case: File of the specification.
        motion: File of the motion.

    Returns:
        The ``faults``, a list, and figures.

    Raises:
        RuntimeError: If the judge itself fails.
    """
    found = subprocess.run(
        [sys.executable, str(program), str(case), str(motion)],
        capture_output=True,
        text=True,
        check=False,
    )
    if found.returncode not in (0, 1) or not found.stdout.strip():
        raise RuntimeError(f"the judge failed on {case}: {found.stderr[-2000:]}")
    return dict(json.loads(found.stdout))
