"""Judges in processes of their own: their command line, and what they are asked.

A judge is a program ``JUDGE.py CASE.json MOTION`` that prints what it finds as JSON and
exits with 1 if it refutes the motion. It imports this module, so nothing here imports
the library.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol


class Judge(Protocol):
    """What is found about one motion.

    Attributes:
        faults: What refutes it, in short sentences.
        figures: What was measured.
    """

    faults: list[str]
    figures: dict[str, float]

    def run(self) -> None:
        """Judge."""


def judge_named(
    usage: str | None, make: Callable[[dict[str, Any], Path], Judge]
) -> int:
    """Judge the motion that the command line names.

    Args:
        usage: What is printed without two files.
        make: Makes the judge, from the case and the file of the motion.

    Returns:
        What the program exits with.
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
    """What a judge says of the file of a motion.

    Args:
        program: The judge.
        case: File of what was asked for.
        motion: File of the motion.

    Returns:
        The ``faults``, a list, and figures.

    Raises:
        RuntimeError: If the judge fails itself.
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
