"""Two UR5s hand a bar over: one arm brings it, the other takes it away.

One motion of two segments, for both arms together: the hands meet at the bar, where
they stay for 0.1 s while one gripper closes and the other opens; then the second arm
carries the bar to its side, and the first returns home. The bar is part of the dynamics
and of the collision checks of the arm that carries it. Writes to out/ a figure, a page
that plays offline, and one file for each arm.

    python examples/handing_over.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import tominpmp as tm
from tominpmp.files.export import export

APART = 0.6  # distance of the bases from the middle [m]
LENGTH, WIDTH, MASS = 0.3, 0.04, 0.8  # of the bar [m, kg]
GAP = 0.02  # distance of a flange from the end of the bar that it holds [m]
CLOSES = 0.1  # time for both grippers [s]
# Start and end of the giving arm, and start and end of the taking arm [rad].
GIVES = np.array([0.9, -1.7, 1.9, -1.8, -1.57, 0.0])
WAITS = np.array([0.6, -1.9, 2.1, -1.8, -1.57, 0.0])
TAKES = np.array([-0.9, -1.7, 1.9, -1.8, -1.57, 0.0])
MEETING = np.array([0.0, 0.0, 0.45])  # middle of the bar when it is handed over [m]


def workcell() -> tm.Workcell:
    """Two arms that face each other."""
    arm = tm.load_robot("ur5", limits="urdf")
    turned = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([APART, 0.0, 0.0]))
    return tm.Workcell({"giver": (arm, (-APART, 0.0, 0.0)), "taker": (arm, turned)})


def bar(arm: str) -> tm.Payload:
    """The bar in the hand of an arm, which holds one end of it, along its axis."""
    middle = np.array([0.0, 0.0, GAP + 0.5 * LENGTH])
    shape = tm.Box("bar", size=(WIDTH, WIDTH, LENGTH), position=middle)
    long, thin = MASS / 12.0 * (LENGTH**2 + WIDTH**2), MASS / 6.0 * WIDTH**2
    return tm.Payload(
        MASS,
        f"{arm}/tool0",
        com=middle,
        inertia=np.diag([long, long, thin]),
        geometry=[shape],
        name="bar",
    )


def hands_at_the_bar() -> dict[str, tm.Goal]:
    """Both hands at the bar, which lies along x, one at each end."""
    half = np.array([0.5 * LENGTH + GAP, 0.0, 0.0])
    ahead = pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0)  # z of the hand along x
    back = pin.rpy.rpyToMatrix(0.0, -np.pi / 2, 0.0)
    return {
        "giver": tm.PoseGoal("tool0", pin.SE3(ahead, MEETING - half)),
        "taker": tm.PoseGoal("tool0", pin.SE3(back, MEETING + half)),
    }


def problem(cell: tm.Workcell) -> tm.Problem:
    """A segment to the bar, and a segment away from it."""
    away = {"giver": tm.JointGoal(GIVES), "taker": tm.JointGoal(TAKES)}
    start = cell.stack({"giver": GIVES, "taker": WAITS})
    holding = [("bar", "giver/wrist_3_link"), ("bar", "taker/wrist_3_link")]
    segments = [
        tm.Segment(
            cell.goal(hands_at_the_bar()),
            payload=bar("giver"),
            may_touch=holding,
            dwell=CLOSES,
        ),
        tm.Segment(cell.goal(away), payload=bar("taker"), may_touch=holding),
    ]
    table = tm.Box("table", size=(0.5, 1.2, 0.04), position=(0.0, 0.0, -0.02))
    scene = tm.Scene([table])
    return tm.Problem(cell.robot, start, scene=scene, margin=0.01, segments=segments)


def main() -> int:
    """Plan, report on the segments, write the figure, the page and the motions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    cell = workcell()
    task = problem(cell)
    solution = tm.plan(task, seed=arguments.seed, starts=1)
    print(solution.message)
    if not solution.success:
        return 1
    brings, takes = solution.segments
    print(f"  both at the bar after {brings.arrival:.3f} s, handed over", end=" ")
    print(f"at {brings.end:.3f} s, put away after {takes.duration:.3f} s more")
    room = solution.verification.min_clearance
    print(f"  the smallest clearance is {1e3 * room:.1f} mm")
    arguments.out.mkdir(parents=True, exist_ok=True)
    figure = arguments.out / "handing_over.png"
    solution.plot(figure)
    page = arguments.out / "handing_over.html"
    solution.play(page, frame="taker/tool0")
    paths = [figure, page]
    for name, motion in cell.split(solution.trajectory).items():
        paths.append(arguments.out / f"handing_over_{name}.csv")
        export(motion, paths[-1], dt=0.001)
    for path in paths:
        print(path)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
