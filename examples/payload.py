"""Motions with an empty hand and with a box in it, and the effect of a forgotten box.

A Panda carries a box of 2.5 kg over a board. Mass, centre of mass, inertia and shape of
the box are part of dynamics and collision checks. Then the motion planned for the empty
hand is verified with the box in it: it needs more torque than the motors have, or the
box hits the board. Writes a page that plays offline and the motions to out/.

    python examples/payload.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm
from tominpmp.dynamics import RobotDynamics

MASS, SIZE = 2.5, (0.12, 0.08, 0.16)  # [kg, m]
# In the axes of the hand, whose z axis points out of it [m].
PLACE = (0.0, 0.0, 0.2)
START = np.array([0.6, 0.35, 0.0, -2.1, 0.0, 2.45, 0.785])
GOAL = np.array([-0.6, -0.1, 0.0, -1.9, 0.0, 1.8, 0.785])
BOARD = tm.Box("board", size=(0.5, 0.04, 0.45), position=(0.5, 0.0, 0.225))


def box() -> tm.Payload:
    """A box of uniform density."""
    x, y, z = SIZE
    inertia = MASS / 12.0 * np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2])
    shape = tm.Box("box", size=SIZE, position=PLACE)
    return tm.Payload(
        MASS, "panda_hand", com=PLACE, inertia=inertia, geometry=[shape], name="box"
    )


def problem(robot: tm.Robot) -> tm.Problem:
    """From one side of the upright board to the other, over it."""
    return tm.Problem(robot, START, tm.JointGoal(GOAL), tm.Scene([BOARD]), margin=0.01)


def main() -> int:
    """Plan with and without the box, and verify the empty motion with the box."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    options = tm.Options(intervals=20, seed=arguments.seed)
    empty = tm.load_robot(
        "panda", limits="urdf", locked_joints={"panda_finger_joint1": 0.04}
    )
    loaded = empty.with_payload(box())
    solutions = {
        "empty": tm.plan(problem(empty), options),
        "loaded": tm.plan(problem(loaded), options),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, solution in solutions.items():
        print(f"{name}: {solution.message}")
        if solution.trajectory is None:
            return 1
        solution.export(arguments.out / f"payload_{name}.csv")

    motion = solutions["empty"].trajectory
    assert motion is not None
    t = np.linspace(0.0, motion.duration, 500)
    q, v, a, _ = motion(t)
    load = np.abs(RobotDynamics(loaded).inverse(q, v, a)) / loaded.limits.effort_upper
    joint = int(np.argmax(load.max(axis=0)))
    print(
        "The motion of the empty hand with the box in it needs "
        f"{100 * load.max():.0f} % of the torque that {loaded.joint_names[joint]} has,"
    )
    contact = problem(loaded).checker.distances(np.asarray(q)).min(axis=0)
    link, other = problem(loaded).checker.pairs[int(np.argmin(contact))]
    print(f"and brings {link} to {1e3 * contact.min():.1f} mm from {other}.")
    page = arguments.out / "payload.html"
    solutions["loaded"].play(page)
    print(page)
    return 0 if all(solution.success for solution in solutions.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
