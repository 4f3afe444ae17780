"""Two UR5s with crates that exchange places over a table: one problem, one duration.

The robots stand on opposite sides of a table. Each holds a crate over one half of it
and has to move it exactly to the position of the other crate, so that straight motions
would collide. Writes to out/ a figure, a page that plays offline and, for each robot,
one file with its motion and its joint names.

    python examples/two_ur5.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import tominpmp as tm
from tominpmp.files.export import export

# Distance of the bases from the middle of the table [m].
APART = 0.51
# A UR5 that holds its hand over the table, pointing down, on its left and its right
# [rad]. For two robots that face each other these are the same two positions.
LEFT = np.array([0.2284, -1.35, 1.75, -1.971, -1.571, 0.0])
RIGHT = np.array([-0.6208, -1.35, 1.75, -1.971, -1.571, 0.0])
# Size of the crate in each hand [m].
CRATE = tm.Box("crate", size=(0.16, 0.16, 0.16), position=(0.0, 0.0, 0.09))


def workcell() -> tm.Workcell:
    """Two UR5s that face each other, each with a crate of 3 kg."""
    crate = tm.Payload(3.0, "tool0", com=CRATE.position, geometry=[CRATE], name="crate")
    arm = tm.load_robot("ur5", limits="urdf").with_payload(crate)
    turned = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([APART, 0.0, 0.0]))
    return tm.Workcell({"near": (arm, (-APART, 0.0, 0.0)), "far": (arm, turned)})


def problem(cell: tm.Workcell) -> tm.Problem:
    """Each crate moves to the start position of the other."""
    table = tm.Box("table", size=(0.7, 1.2, 0.04), position=(0.0, 0.0, -0.03))
    return cell.problem(
        start={"near": LEFT, "far": LEFT},
        goal={"near": tm.JointGoal(RIGHT), "far": tm.JointGoal(RIGHT)},
        scene=tm.Scene([table]),
        margin=0.01,
    )


def main() -> int:
    """Plan, report, write the figure, the page and the motions."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    cell = workcell()
    task = problem(cell)
    options = tm.Options(seed=arguments.seed)
    solution = tm.plan(task, options)
    print(f"together: {solution.message}")
    if solution.trajectory is None:
        return 1
    if solution.verification is not None:
        print(f"smallest clearance: {1e3 * solution.verification.min_clearance:.1f} mm")
    alone = tm.plan(tm.Problem(cell.alone("near"), LEFT, tm.JointGoal(RIGHT)), options)
    print(f"a single arm without obstacles: T = {alone.T:.4f} s")
    arguments.out.mkdir(parents=True, exist_ok=True)
    figure = arguments.out / "two_ur5.png"
    solution.plot(figure)
    page = arguments.out / "two_ur5.html"
    solution.play(page)
    paths = [figure, page]
    for name, motion in cell.split(solution.trajectory).items():
        paths.append(arguments.out / f"two_ur5_{name}.csv")
        export(motion, paths[-1])
    for path in paths:
        print(path)
    return 0 if solution.success else 1


if __name__ == "__main__":
    raise SystemExit(main())
