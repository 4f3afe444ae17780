"""Interrupts: Ctrl-C at random instants of plans, and their results.

    python -m benchmarks.interrupts
    python -m benchmarks.interrupts --count 20 --seed 3

Each of ``--count`` plans of a few problems is interrupted once, at an instant drawn
uniformly from the duration of the whole plan. It has to return soon, with the status
INTERRUPTED, and with a verified motion or no motion at all. A motion found before the
interrupt must not be lost, which is checked by the records that the callback received.
A plan that ended before the interrupt counts as ended.

Results go to a CSV file; the exit code is 1 if a rule is broken.
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import tominpmp as tm

COLUMNS = (
    "problem",
    "whole",
    "instant",
    "status",
    "verified",
    "T",
    "late",
    "seconds",
    "broken",
)
# Longest time from the interrupt to the return [s], and as a share of the whole plan.
SOON, SHARE = 3.5, 0.5

PLANAR = (0.5, 1.7, -1.7), (2.0, -1.0, 0.5)
READY = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
SWUNG = (1.6, 0.4, 0.0, -1.2, 0.0, 2.0, 0.785)


def reach(**changes: Any) -> tm.Problem:
    """The bundled planar arm next to a ball."""
    ball = tm.Sphere("ball", radius=0.4, position=(3.0, 1.0, 0.0))
    goal = tm.JointGoal(PLANAR[1])
    robot, scene = tm.load_robot("planar3r"), tm.Scene([ball])
    return tm.Problem(robot, PLANAR[0], goal, scene=scene, **changes)


def panda() -> tm.Robot:
    """A Panda with its fingers closed."""
    fingers = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
    return tm.load_robot("panda", limits="urdf", locked_joints=fingers)


def among_boxes() -> tm.Problem:
    """A Panda that reaches round a box."""
    box = tm.Box("box", size=(0.1, 0.1, 0.5), position=(0.45, 0.25, 0.45))
    return tm.Problem(panda(), READY, tm.JointGoal(SWUNG), scene=tm.Scene([box]))


def in_segments() -> tm.Problem:
    """A Panda that carries a load to a point, and returns without it."""
    load = tm.Payload(frame="panda_hand", mass=0.8, com=(0.0, 0.0, 0.1))
    ways = [
        tm.Segment(tm.JointGoal(SWUNG), payload=load, stop=True),
        tm.Segment(tm.JointGoal(READY)),
    ]
    return tm.Problem(panda(), READY, segments=ways)


PROBLEMS: dict[str, tuple[Callable[[], tm.Problem], dict[str, Any]]] = {
    "planar3r, a ball": (reach, {}),
    "planar3r, a clock": (reach, {"control_period": 0.004}),
    "Panda, a box": (among_boxes, {}),
    "Panda, segments": (in_segments, {}),
    "Panda, quiet torques": (among_boxes, {"slack": 0.02}),
}


class Seen:
    """A callback that notes whether a record satisfied all constraints."""

    def __init__(self) -> None:
        self.found = False

    def __call__(self, record: tm.IterationRecord) -> None:
        """Examine a record."""
        self.found |= record.violation <= tm.Options().feasibility


def interrupted(problem: tm.Problem, options: dict[str, Any], instant: float) -> Any:
    """Plan, with Ctrl-C after a time [s]; the solution, and the planning time."""

    def press(number: int, frame: FrameType | None) -> None:
        signal.raise_signal(signal.SIGINT)

    former = signal.signal(signal.SIGALRM, press)
    seen, begin = Seen(), time.perf_counter()
    signal.setitimer(signal.ITIMER_REAL, instant)
    try:
        solution = tm.plan(problem, tm.Options(**options), callback=seen)
        return solution, time.perf_counter() - begin, seen.found
    except KeyboardInterrupt:
        return None, time.perf_counter() - begin, seen.found
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)


def row(name: str, whole: float, instant: float) -> dict[str, Any]:
    """Interrupt a plan; returns its row."""
    make, options = PROBLEMS[name]
    solution, seconds, found = interrupted(make(), options, instant)
    late, broken = seconds - instant, []
    if solution is None:
        broken.append("KeyboardInterrupt")
    elif late > 0.0:
        if solution.status is not tm.Status.INTERRUPTED:
            broken.append("status")
        clocked = "control_period" in options or "slack" in options
        if found and not solution.success and not clocked:
            broken.append("a motion is lost")
    if solution is not None and solution.success and not solution.verification.ok:
        broken.append("not verified")
    if late > SOON + SHARE * whole:
        broken.append("late")
    return {
        "problem": name,
        "whole": whole,
        "instant": instant,
        "status": "" if solution is None else solution.status.name,
        "verified": solution is not None and solution.success,
        "T": np.inf if solution is None else solution.T,
        "late": late,
        "seconds": seconds,
        "broken": "; ".join(broken),
    }


def main(argv: list[str] | None = None) -> int:
    """Interrupt plans; 1 if a rule is broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--csv", type=Path, default=Path("out/interrupts.csv"))
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    warnings.simplefilter("ignore")
    rng, wholes = np.random.default_rng(arguments.seed), dict[str, float]()
    for name, (make, options) in PROBLEMS.items():
        for _ in range(2):  # libraries load in the first plan
            begin = time.perf_counter()
            tm.plan(make(), tm.Options(**options))
            wholes[name] = time.perf_counter() - begin
    sheet = Sheet(arguments.csv, COLUMNS)
    names = list(PROBLEMS)
    for number in range(arguments.count):
        name = names[number % len(names)]
        instant = float(rng.uniform(0.002, 1.0)) * wholes[name]
        sheet.add(row(name, wholes[name], instant))
    lines = []
    for name in names:
        late = np.array(sheet.column("late", problem=name))
        states = sheet.column("status", problem=name)
        lines.append(
            (
                name,
                late.size,
                states.count("INTERRUPTED"),
                sum(sheet.column("verified", problem=name)),
                float(np.max(late)),
                sum(map(bool, sheet.column("broken", problem=name))),
            )
        )
    header = ("problem", "plans", "interrupted", "verified", "latest return s")
    print(markdown((*header, "broken"), lines))
    return int(any(row["broken"] for row in sheet.rows))


if __name__ == "__main__":
    sys.exit(main())
