"""Signals at random moments of the command line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

COMMAND = (
    "plan", "planar3r", "--start", "0.5,1.7,-1.7", "--goal", "2,-1,0.5",
    "--obstacle", "sphere:O:r=0.3:at=4,1,0",
)  # fmt: skip
# No process may run for longer than this after a signal [s]; starting takes about 1 s.
PATIENCE = 20.0
LATEST = 6.0
# Exit codes of the command line, and those that a shell reports for a signal.
CODES = {0, 1, 2, 130, 143, -signal.SIGINT, -signal.SIGTERM}


def left_behind(group: int) -> list[int]:
    """Processes of a group that are alive."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            parts = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(parts[2]) == group and parts[0] != "Z":
            found.append(int(entry.name))
    return found


def _heed_interrupts() -> None:
    """Restore the handling of Ctrl-C, which shells ignore for background jobs."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Signals:
    """Runs of the command line that a signal ends, by number."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, rng: np.random.Generator) -> tuple[str, Callable[[], Any]]:
        """Choose options, a signal and a moment.

        Returns:
            What it is, and the call that judges it.
        """
        options = ["-o", "motion.csv"]
        if rng.random() < 0.4:
            options += ["--refine", str(rng.choice(["grid", "switching"]))]
        if rng.random() < 0.4:
            options += ["--processes", "2", "--starts", "4"]
        kind = signal.SIGINT if rng.random() < 0.5 else signal.SIGTERM
        moment = float(rng.uniform(0.0, LATEST))
        label = f"{kind.name} after {moment:.2f} s: {' '.join(options)}"
        return label, lambda: self._judge(options, kind, moment)

    def _judge(self, options: list[str], kind: signal.Signals, moment: float) -> None:
        before = set(self.folder.iterdir())
        child = subprocess.Popen(
            [sys.executable, "-m", "tominpmp", *COMMAND, *options],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            preexec_fn=_heed_interrupts,
        )
        try:
            time.sleep(moment)
            child.send_signal(kind)
            # Until all processes that inherited the output have closed it.
            text = child.communicate(timeout=PATIENCE)[0].decode(errors="replace")
            time.sleep(0.1)
            left = left_behind(child.pid)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"goes on {PATIENCE} s after the signal") from None
        finally:
            for pid in left_behind(child.pid):
                os.kill(pid, signal.SIGKILL)
            child.wait()
        started = moment > 2.0  # before that Python itself may be interrupted
        wrong = [
            f"left {left}" if left else "",
            f"exit code {child.returncode}" if child.returncode not in CODES else "",
            "a traceback" if "Traceback" in text and started else "",
            "a defect" if "defect of tominpmp" in text else "",
        ]
        drafts = [p for p in self.folder.iterdir() if p.suffix == ".part"]
        wrong += [f"half a file {drafts[0].name}"] if drafts else []
        for path in set(self.folder.iterdir()) - before:
            path.unlink()
        if any(wrong):
            raise AssertionError(", ".join(filter(None, wrong)) + f": {text[-300:]}")
