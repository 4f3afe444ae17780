"""Two hundred plans of a planar arm, several at once, kept as a dataset.

Random goals of its tip next to an obstacle. A second call reads the results of the
first call, and plans the missing problems. Writes the results to a folder of out/.

    python examples/batch.py [--out FOLDER] [--count 200] [--workers 2]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import tominpmp as tm
from tominpmp.cell.batch import Progress

START = (0.5, 1.7, -1.7)
OBSTACLE = tm.Scene([tm.Sphere("O", radius=0.3, position=(4.2, 2.4, 0.0))])


def problems(count: int, seed: int) -> Iterator[tuple[str, tm.Problem]]:
    """Random goals within reach, made one by one as they are needed.

    An invalid goal, such as a point inside the obstacle, is drawn again, before a
    problem is made.
    """
    robot, rng = tm.load_robot("planar3r"), np.random.default_rng(seed)
    number = 0
    while number < count:
        angle, reach = rng.uniform(0.2, 1.2), rng.uniform(3.4, 4.6)
        point = (reach * np.cos(angle), reach * np.sin(angle), 0.0)
        goal = tm.PositionGoal("tip", point)
        try:
            problem = tm.Problem(robot, START, goal, OBSTACLE, 0.02)
        except tm.ProblemError:
            continue
        yield f"goal{number:04d}", problem
        number += 1


def show(state: Progress) -> None:
    """Print the progress after each twenty problems."""
    if state.done % 20 == 0:
        print(f"{state.done} done, {state.found} with a motion, {state.seconds:.0f} s")


def main() -> int:
    """Plan, and print a summary of the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    results = arguments.out / "batch"
    found = 0
    for outcome in tm.plan_many(
        problems(arguments.count, arguments.seed),
        workers=arguments.workers,
        results=results,
        seed=arguments.seed,
        intervals=20,
        starts=1,
        max_planning_time=30.0,
        progress=show,
    ):
        found += outcome.success
        if not outcome.success:
            print(f"{outcome.name}: {outcome.message}")
    dataset = tm.Dataset(results)
    times = [entry.T for entry in dataset if entry.success]
    print(f"{found} of {arguments.count} have a motion; {len(dataset)} files")
    print(f"T is {min(times):.3f} to {max(times):.3f} s, mean {np.mean(times):.3f} s")
    return 0 if found else 1


if __name__ == "__main__":
    raise SystemExit(main())
