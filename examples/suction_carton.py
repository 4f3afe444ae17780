"""A UR5 lifts a heavy carton by a suction cup and sets it down on the other side.

The cup pulls with at most 150 N; the carton of 3 kg hangs from it, and its centre is
0.1 m below. The wrench at the cup must not exceed its holding capacity: the friction
across it, its pull along the axis, and the moment about its rim, over which the carton
could be torn off. A weaker vacuum requires a slower motion. Writes a page to out/.

    python examples/suction_carton.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

FRAME = "tool0"  # its z points down, out of the cup
START = (-0.7, -1.5, 1.7, -1.7708, -1.5708, 0.0)
GOAL = (0.8, -1.5, 1.7, -1.7708, -1.5708, 0.0)
MASS, SIZE = 3.0, (0.2, 0.2, 0.2)  # of the carton [kg, m]
FRICTION, RADIUS = 0.5, 0.04  # of the cup [1, m]
PULLS = (150.0, 90.0)  # [N]
OPTIONS = tm.Options(intervals=40, control="linear", effort="quick", refine=None)


def problem(pull: float) -> tm.Problem:
    """The carton on its cup, from one side to the other."""
    inertia = MASS * SIZE[0] ** 2 / 6.0 * np.eye(3)
    middle = (0.0, 0.0, 0.5 * SIZE[2])
    carton = tm.Box("carton", size=SIZE, position=(0.0, 0.0, 0.5 * SIZE[2] + 0.01))
    load = tm.Payload(
        MASS, FRAME, com=middle, inertia=inertia, geometry=[carton], name="carton"
    )
    cup = tm.StableContact(
        FRAME, middle, FRICTION, RADIUS, mass=MASS, inertia=inertia, adhesion=pull
    )
    robot = tm.load_robot("ur5", limits="urdf").with_payload(load)
    return tm.Problem(robot, START, tm.JointGoal(GOAL), constraints=(cup,))


def main() -> int:
    """Plan with both vacuums, report both, write the page of the first."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for pull in PULLS:
        solution = tm.plan(problem(pull), OPTIONS, seed=arguments.seed)
        print(f"{pull:g} N: {solution.message}")
        if not solution.success:
            return 1
        if pull == PULLS[0]:
            solution.play(arguments.out / "suction_carton.html")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
