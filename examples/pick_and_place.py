"""A Panda moves a box from one side of a wall to the other, in one motion.

Seven goals in a row: over the box, at the box, where the gripper closes for 50 ms, up
with the box, over the wall, down to the table, where the gripper opens, up, and home.
The arm stops only where it grips and releases. While it carries the box, its mass is
part of the dynamics and its shape of the collision checks; box and table may touch
while it is lifted and put down. Writes to out/ a figure, a page that plays
offline and the motion.

    python examples/pick_and_place.py [--out FOLDER] [--seed 0]

The same problem is in examples/scenarios/pick_and_place.toml, for `tominpmp plan`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

import tominpmp as tm

HOME = np.array([0.0, -0.6, 0.0, -2.2, 0.0, 1.6, 0.785])
TCP = "panda_hand_tcp"
TOP, LIFT = 0.2, 0.12  # of the table, and above the positions of the box [m]
MASS, SIZE = 1.0, (0.04, 0.04, 0.1)  # of the box [kg, m]
PICK, PLACE = (0.5, 0.25), (0.5, -0.25)  # [m]
# The hand points down, its fingers close along y.
DOWN = np.diag([1.0, -1.0, -1.0])
GRIP = 0.05  # time for the gripper [s]
OPTIONS = tm.Options(intervals=12, control="constant")


def pose(place: tuple[float, float], above: float = 0.0) -> tm.PoseGoal:
    """The hand at the box at a position on the table, or above it."""
    height = TOP + 0.5 * SIZE[2] + 0.002 + above
    return tm.PoseGoal(TCP, pin.SE3(DOWN, np.array([*place, height])))


def box() -> tm.Payload:
    """A box of uniform density, gripped at its centre."""
    x, y, z = SIZE
    inertia = MASS / 12.0 * np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2])
    shape = tm.Box("box", size=SIZE)
    return tm.Payload(MASS, TCP, inertia=inertia, geometry=[shape], name="box")


def problem() -> tm.Problem:
    """Over the wall with the box, and home without it."""
    robot = tm.load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.04}
    )
    table = tm.Box("table", size=(0.5, 0.9, 0.04), position=(0.55, 0.0, TOP - 0.02))
    wall = tm.Box("wall", size=(0.3, 0.02, 0.1), position=(0.5, 0.0, TOP + 0.05))
    load, touch = box(), [("box", "table")]
    segments = [
        tm.Segment(pose(PICK, LIFT)),
        tm.Segment(pose(PICK), dwell=GRIP),
        tm.Segment(pose(PICK, LIFT), payload=load, may_touch=touch),
        tm.Segment(pose(PLACE, LIFT), payload=load),
        tm.Segment(pose(PLACE), payload=load, may_touch=touch, dwell=GRIP),
        tm.Segment(pose(PLACE, LIFT)),
        tm.Segment(tm.JointGoal(HOME)),
    ]
    scene = tm.Scene([table, wall])
    return tm.Problem(robot, HOME, scene=scene, margin=0.005, segments=segments)


def main() -> int:
    """Plan, report on the segments, write the figure, the page and the motion."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    task, options = problem(), replace(OPTIONS, seed=arguments.seed)
    solution = tm.plan(task, options)
    print(solution.message)
    if solution.trajectory is None:
        return 1
    for number, segment in enumerate(solution.segments, start=1):
        print(f"  segment {number}: {segment.begin:.3f} s to {segment.end:.3f} s")
    arguments.out.mkdir(parents=True, exist_ok=True)
    solution.plot(arguments.out / "pick_and_place.png")
    solution.play(arguments.out / "pick_and_place.html")
    solution.export(arguments.out / "pick_and_place.csv")
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"pick_and_place.{ending}")
    return 0 if solution.success else 1


if __name__ == "__main__":
    raise SystemExit(main())
