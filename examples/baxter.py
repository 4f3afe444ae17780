"""Both arms of a Baxter move at once: 14 joints from one description.

The left hand moves up, the right hand down over a table. The final positions of the
hands are given, the configuration is free: two goals for two frames are combined into
one goal for all joints. The arms share one duration T, and avoid collisions with each
other, head, pedestal and table. Writes a figure, a page that plays offline and the
motion to out/.

    python examples/baxter.py [--out FOLDER] [--seed 0] [--intervals 20]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

# Head and fingers do not move.
LOCKED = {
    "head_pan": 0.0,
    "l_gripper_l_finger_joint": 0.0,
    "r_gripper_l_finger_joint": 0.0,
}
# Waiting configuration of the left arm, mirrored for the right arm [rad].
WAITING = {
    "s0": -0.08,
    "s1": -1.0,
    "e0": -1.19,
    "e1": 1.94,
    "w0": 0.67,
    "w1": 1.03,
    "w2": -0.5,
}
MIRRORED = ("s0", "e0", "w0", "w2")
TABLE = tm.Box("table", size=(0.6, 1.6, 0.04), position=(0.8, 0.0, -0.2))


def problem() -> tm.Problem:
    """Both hands move at once, each to a point."""
    robot = tm.load_robot("baxter", locked_joints=LOCKED)
    waiting = {f"left_{joint}": angle for joint, angle in WAITING.items()} | {
        f"right_{joint}": -angle if joint in MIRRORED else angle
        for joint, angle in WAITING.items()
    }
    start = np.array([waiting[joint] for joint in robot.joint_names])
    goal = tm.AllGoals(
        [
            tm.PositionGoal("left_gripper", (0.70, 0.30, 0.55)),
            tm.PositionGoal("right_gripper", (0.75, 0.10, -0.05)),
        ]
    )
    return tm.Problem(robot, start, goal, tm.Scene([TABLE]), margin=0.02)


def main() -> int:
    """Plan, report, write the figure, the page and the motion."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--intervals", type=int, default=20)
    arguments = parser.parse_args()
    task = problem()
    options = tm.Options(intervals=arguments.intervals, starts=2, seed=arguments.seed)
    solution = tm.plan(task, options)
    print(solution.message)
    if solution.trajectory is None:
        return 1
    print(f"{task.robot.n} joints, {len(task.checker.pairs)} collision pairs checked")
    if solution.verification is not None:
        nearest = 1e3 * solution.verification.min_clearance
        print(f"smallest clearance: {nearest:.1f} mm")
    arguments.out.mkdir(parents=True, exist_ok=True)
    figure, page, table = (
        arguments.out / f"baxter.{ending}" for ending in ("png", "html", "csv")
    )
    solution.plot(figure)
    solution.play(page)
    solution.export(table)
    for path in (figure, page, table):
        print(path)
    return 0 if solution.success else 1


if __name__ == "__main__":
    raise SystemExit(main())
