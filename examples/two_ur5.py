"""Two UR5s that exchange places over a table, as one problem with one duration.

The robots stand on opposite sides of a table, each with its hand over one half of it,
and each has to bring it over the half where the other one's is. They must not touch
each other on the way. Writes a page with the motion to out/, which plays offline.

    python examples/two_ur5.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import tominpmp as tm

# Distance of the bases from the middle of the table [m].
APART = 0.55
# Joint positions of a UR5 with its hand over the table, on its left or right [rad].
LEFT = np.array([0.5, -1.15, 1.75, -2.17, -1.571, 0.0])
RIGHT = np.array([-0.5, -1.15, 1.75, -2.17, -1.571, 0.0])


def workcell() -> tm.Robot:
    """Two UR5s that face each other."""
    arm = tm.load_robot("ur5")
    turned = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([APART, 0.0, 0.0]))
    return tm.combine_robots([("near", arm, (-APART, 0.0, 0.0)), ("far", arm, turned)])


def problem(cell: tm.Robot) -> tm.Problem:
    """Each hand goes to where the other one was."""
    table = tm.Box("table", size=(0.7, 1.2, 0.04), position=(0.0, 0.0, -0.03))
    return tm.Problem(
        cell,
        cell.stack(near=LEFT, far=LEFT),
        tm.JointGoal(cell.stack(near=RIGHT, far=RIGHT)),
        tm.Scene([table]),
        margin=0.01,
    )


def main() -> int:
    """Plan, report and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    task = problem(workcell())
    solution = tm.plan(task, tm.Options(seed=arguments.seed))
    print(solution.message)
    if solution.trajectory is None:
        return 1
    arguments.out.mkdir(parents=True, exist_ok=True)
    solution.play(arguments.out / "two_ur5.html")
    print(arguments.out / "two_ur5.html")
    return 0 if solution.feasible else 1


if __name__ == "__main__":
    raise SystemExit(main())
