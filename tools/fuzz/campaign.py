"""The campaign: inputs by seed and number, tried in separate processes.

An input fails if it raises an exception of another library, if its message is empty or
too long, if it takes too much time or memory, or if it ends the process that tries it.
A new process is then started, and continues with the next input.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

# Number of inputs of each family in a campaign of 20 000, and the time limit of an
# input [s].
SHARES = {"files": 11_000, "arguments": 7_900, "options": 1_000, "signals": 100}
SECONDS = {"files": 20.0, "arguments": 20.0, "options": 40.0, "signals": 60.0}
# Memory of the process that tries them [MB].
MEMORY = 1000
LONGEST = 3000
# Longest silence of a process, in time limits of an input: machines may be busy.
PATIENCE = 15.0
# Number of inputs after which a process is replaced.
CHUNK = 500
ROOT = Path(__file__).resolve().parents[2]


def inputs_of(family: str, folder: Path) -> Any:
    """Generator of the inputs of a family."""
    if family == "files":
        from tools.fuzz.damage import Damage

        return Damage(folder)
    if family == "arguments":
        from tools.fuzz.arguments import Wrong

        return Wrong()
    if family == "options":
        from tools.fuzz.mixtures import Mixtures

        return Mixtures()
    from tools.fuzz.signals import Signals

    return Signals(folder)


def peak() -> int:
    """Largest memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text().split("VmHWM:")[1].split()[0]) // 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


class TooLongError(Exception):
    """An input exceeded its time limit."""


def _alarm(_: int, __: FrameType | None) -> None:
    raise TooLongError


def judge(call: Any, seconds: float) -> tuple[str, str]:
    """Try an input.

    Returns:
        The outcome, "taken", "refused" or "failed", and the reason of a failure.
    """
    from tominpmp.exceptions import TominpmpError

    # Processor time, as the input is not to blame for a busy machine. The parent, which
    # reads the output of this process, ends it if it sleeps.
    signal.signal(signal.SIGPROF, _alarm)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    before = peak()
    try:
        with warnings.catch_warnings(), open(os.devnull, "w") as nothing:
            warnings.simplefilter("ignore")
            with contextlib.redirect_stdout(nothing):
                call()
        outcome, why = "taken", ""
    except TominpmpError as error:
        outcome, why = "refused", ""
        if not str(error).strip() or len(str(error)) > LONGEST:
            outcome, why = "failed", f"a message of {len(str(error))} characters"
    except TooLongError:
        outcome, why = "failed", f"takes more than {seconds} s"
    except BaseException as error:  # any other exception is a failure
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}:{last.lineno}"
        outcome = "failed"
        why = f"{type(error).__name__} at {place}: {str(error)[:300]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    if outcome != "failed" and peak() > max(MEMORY, before):
        return "failed", f"takes {peak()} MB"
    return outcome, why


def work(family: str, seed: int, begin: int, end: int) -> None:
    """Try inputs one after the other, with a report before and after each."""
    # The system refuses memory beyond this limit, as on a small machine.
    resource.setrlimit(resource.RLIMIT_AS, (8 * 2**30, 8 * 2**30))
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        os.chdir(folder)
        os.environ.setdefault("MPLBACKEND", "Agg")
        inputs = inputs_of(family, Path(folder))
        for number in range(begin, end):
            rng = np.random.default_rng([seed, number, *family.encode()])
            label, call = inputs.run(rng)
            _tell({"number": number, "label": label})
            outcome, why = judge(call, SECONDS[family])
            _tell({"number": number, "outcome": outcome, "why": why, "peak": peak()})
        os.chdir(ROOT)


def _tell(what: dict[str, Any]) -> None:
    sys.__stdout__.write(json.dumps(what) + "\n")  # type: ignore[union-attr]
    sys.__stdout__.flush()  # type: ignore[union-attr]


@dataclass
class Tally:
    """Results of a family."""

    outcomes: Counter[str]
    failures: list[dict[str, Any]]
    peak: int = 0
    seconds: float = 0.0


def attempt(family: str, seed: int, begin: int, end: int, tally: Tally) -> int:
    """Try inputs in a process; returns the number of the next input."""
    command = [sys.executable, "-m", "tools.fuzz", "--work", family]
    command += ["--seed", str(seed), "--begin", str(begin), "--end", str(end)]
    with tempfile.TemporaryFile("w+") as complaints:
        child = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=complaints, text=True
        )
        number, label = begin, "starting"
        for line in _lines(child, PATIENCE * SECONDS[family]):
            said = json.loads(line)
            number = said["number"]
            if "label" in said:
                label = said["label"]
                continue
            tally.outcomes[said["outcome"]] += 1
            tally.peak = max(tally.peak, said["peak"])
            if said["outcome"] == "failed":
                tally.failures.append({"family": family, "label": label, **said})
            label = ""
            number += 1
        assert child.stdout is not None  # noqa: S101
        child.stdout.close()
        child.wait()
        if not label and child.returncode == 0:
            return number
        complaints.seek(0)
        why = f"ended the process ({child.returncode}): {complaints.read()[-500:]}"
    tally.outcomes["failed"] += 1
    tally.failures.append(
        {"family": family, "number": number, "label": label, "why": why}
    )
    return number + 1


def _lines(child: subprocess.Popen[str], patience: float) -> Iterator[str]:
    """Lines of output of a process, until it ends or is silent for too long."""
    import select

    assert child.stdout is not None  # noqa: S101
    while True:
        ready, _, _ = select.select([child.stdout], [], [], patience)
        line = child.stdout.readline() if ready else ""
        if not ready:
            child.kill()
        if not line:
            return
        yield line


def campaign(shares: dict[str, int], seed: int, out: Path | None) -> list[Any]:
    """Try a number of inputs of each family; returns the failed ones."""
    failures: list[Any] = []
    for family, count in shares.items():
        tally, begin = Tally(Counter(), []), time.perf_counter()
        number = 0
        while number < count:
            number = attempt(family, seed, number, min(number + CHUNK, count), tally)
            _keep(out, failures + tally.failures)
            _say(f"{family}: {number} of {count}, {dict(tally.outcomes)}")
        tally.seconds = time.perf_counter() - begin
        failures += tally.failures
        print(
            f"{family:10} {count:6} inputs: {dict(tally.outcomes)}, "
            f"{tally.peak} MB, {tally.seconds:.0f} s",
            flush=True,
        )
    for item in failures:
        print(f"FAILED {item['family']} {item['number']}: {item['label']}")
        print(f"       {item['why']}")
    return failures


def _keep(out: Path | None, failures: list[Any]) -> None:
    """Write the failures so far."""
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / "failures.json").write_text(json.dumps(failures, indent=1))


def _say(text: str) -> None:
    """Print the progress."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def main() -> int:
    """Run the campaign with the arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="number of inputs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fuzz")
    parser.add_argument("--family", choices=sorted(SHARES), help="only these")
    parser.add_argument("--work", choices=sorted(SHARES), help=argparse.SUPPRESS)
    parser.add_argument(
        "--begin", type=int, default=0, help="first number, with --work"
    )
    parser.add_argument("--end", type=int, default=0, help="number after the last")
    given = parser.parse_args()
    if given.work:
        work(given.work, given.seed, given.begin, given.end)
        return 0
    total = sum(SHARES.values())
    shares = {k: max(1, given.count * n // total) for k, n in SHARES.items()}
    if given.family:
        shares = {given.family: given.count}
    return 1 if campaign(shares, given.seed, given.out) else 0
