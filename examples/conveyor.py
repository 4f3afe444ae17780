"""A UR5 reaches across a belt on which a crate passes.

The arm moves its tool from this side of a conveyor to the other. A crate crosses its
path at constant speed, and has passed soon after. The duration T includes the time for
which the arm waits: the optimiser finds how early the arm can start and how closely it
can follow. Writes a page that plays offline, the motion and a picture to out/.

    python examples/conveyor.py [--out FOLDER] [--seed 0] [--speed 1.0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

# The belt runs along y in front of the arm [m].
BELT = tm.Box("belt", size=(0.25, 2.4, 0.08), position=(0.55, 0.0, -0.05))
CRATE = (0.2, 0.3, 0.25)
# Position of the crate at the start [m], and speed of the belt [m/s].
COMES_FROM, SPEED = -0.25, 1.0
# The tool points down 12 cm above the floor, on this side of the belt and beyond it.
NEAR = np.array([-0.028, -1.584, 2.503, -2.49, -1.571, 0.0])
FAR = np.array([-0.012, -0.697, 1.116, -1.99, -1.571, 0.0])


def crate(speed: float) -> tm.Box:
    """A crate that moves with the belt."""
    return tm.Box(
        "crate",
        size=CRATE,
        position=(0.55, COMES_FROM, CRATE[2] / 2),
        motion=tm.ConstantVelocity(velocity=(0.0, speed, 0.0)),
    )


def problem(speed: float | None = SPEED) -> tm.Problem:
    """Across the belt, from rest to rest; without the crate if no speed is given."""
    obstacles = [BELT] if speed is None else [BELT, crate(speed)]
    robot = tm.load_robot("ur5", limits="urdf")
    return tm.Problem(robot, NEAR, tm.JointGoal(FAR), tm.Scene(obstacles), margin=0.01)


def main() -> int:
    """Plan, report and write the page, the motion and the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", type=float, default=SPEED, help="of the belt [m/s]")
    arguments = parser.parse_args()
    options = tm.Options(intervals=20, seed=arguments.seed)
    solution = tm.plan(problem(arguments.speed), options)
    print(solution.message)
    if solution.trajectory is None:
        return 1
    print(solution.prove_clearance().message)
    print(f"Without the crate: {tm.plan(problem(None), options).message}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    page, table = (arguments.out / f"conveyor.{ending}" for ending in ("html", "csv"))
    solution.play(path=page, ghosts=6)
    solution.export(table)
    figure = arguments.out / "conveyor.png"
    solution.plot(figure)
    for path in (page, table, figure):
        print(path)
    return 0 if solution.success else 1


if __name__ == "__main__":
    raise SystemExit(main())
