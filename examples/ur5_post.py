"""A UR5 swings a tool around a post between start and goal.

The straight line between start and goal passes 7 cm deep through the post. The library
nevertheless begins with this line, and the linear programs push it out. The detour
costs next to nothing: the first joint determines T, the others have time to spare.
Writes to out/ a figure, a page that plays offline and the motion.

    python examples/ur5_post.py [--out FOLDER] [--seed 0]

The same problem is in examples/scenarios/ur5_post.toml, for `tominpmp plan`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

START = np.array([-0.9, -1.2, 1.4, -1.77, -1.57, 0.0])
GOAL = np.array([0.9, -1.2, 1.4, -1.77, -1.57, 0.0])


def problem() -> tm.Problem:
    """From one side of the post to the other, over a table."""
    post = tm.Cylinder("post", radius=0.05, length=1.0, position=(0.65, 0.15, 0.5))
    table = tm.Box("table", size=(2.0, 2.0, 0.1), position=(0.0, 0.0, -0.06))
    return tm.Problem(
        tm.load_robot("ur5", limits="urdf"),
        START,
        tm.JointGoal(GOAL),
        tm.Scene([post, table]),
        margin=0.01,
    )


def main() -> int:
    """Plan, prove, write the figure, the page and the motion."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    task = problem()
    solution = tm.plan(task, tm.Options(seed=arguments.seed))
    print(solution.message)
    if solution.trajectory is None:
        return 1
    print(solution.prove_clearance().message)
    certificate = solution.certificate
    assert certificate is not None
    print(certificate.message)
    free = tm.plan(tm.Problem(task.robot, task.q_start, task.goal))
    print(f"Without the post: {free.message}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    solution.plot(arguments.out / "ur5_post.png")
    solution.play(arguments.out / "ur5_post.html", ghosts=5)
    solution.export(arguments.out / "ur5_post.csv")
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"ur5_post.{ending}")
    return 0 if solution.success else 1


if __name__ == "__main__":
    raise SystemExit(main())
