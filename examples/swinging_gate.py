"""The paper's planar arm passes a gate that swings open.

The gate blocks the path from below to above. It begins to turn about its hinge at 1.5 s
and is open at 2.5 s. The time of the motion counts from the start, so that waiting is
part of it: the arm starts before the gate is open, and follows it as closely as its
motors permit. Writes a page with the motion to out/, which plays offline.

    python examples/swinging_gate.py [--out FOLDER] [--seed 0]

The same problem is in examples/scenarios/swinging_gate.toml.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

HINGE = (6.0, 2.5, 0.0)
LENGTH = 5.0
OPENS, OPEN = 1.5, 2.5  # [s]


def gate() -> tm.Box:
    """A gate that turns by a right angle about its hinge."""
    x, y, z = HINGE
    swing = tm.ConstantVelocity(
        angular=(0.0, 0.0, -0.5 * np.pi / (OPEN - OPENS)),
        pivot=HINGE,
        begin=OPENS,
        end=OPEN,
    )
    return tm.Box(
        "gate", size=(LENGTH, 0.2, 1.0), position=(x - LENGTH / 2, y, z), motion=swing
    )


def problem() -> tm.Problem:
    """From below the gate to above it, from rest to rest."""
    return tm.Problem(
        tm.load_robot("planar3r"),
        [0.2, 0.0, 0.0],
        tm.JointGoal([1.6, 0.0, 0.0]),
        tm.Scene([gate()]),
        margin=0.02,
    )


def main() -> int:
    """Plan, report and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    task = problem()
    options = tm.Options(seed=arguments.seed)
    solution = tm.plan(task, options)
    print(solution.message)
    if solution.trajectory is None:
        return 1
    print(solution.prove_clearance().message)
    alone = tm.plan(tm.Problem(task.robot, task.q_start, task.goal), options)
    print(f"Without the gate: {alone.message}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    solution.play(path=arguments.out / "swinging_gate.html", ghosts=6)
    print(arguments.out / "swinging_gate.html")
    return 0 if solution.feasible else 1


if __name__ == "__main__":
    raise SystemExit(main())
