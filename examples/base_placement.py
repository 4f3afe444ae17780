"""Move the base of an arm so that three goals take less time.

A planar arm reaches three points from one configuration. Its base is moved along the
gradients of the durations; the sensitivities of the slowest of the three motions with
the new base are drawn as a bar chart.

    python examples/base_placement.py [--out FOLDER]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tominpmp as tm

START = (0.5, 1.7, -1.7)
POINTS = ((4.0, 1.0, 0.0), (3.0, 3.5, 0.0), (4.4, 2.0, 0.0))
BOUNDS = {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "yaw": (-0.3, 0.3)}


def main() -> int:
    """Move the base and show the gain."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--plans", type=int, default=40, help="at most")
    arguments = parser.parse_args()
    robot = tm.load_robot("planar3r")
    tasks = [tm.Problem(robot, START, tm.PositionGoal("tip", p)) for p in POINTS]
    found = tm.improve_placement(
        robot,
        tasks,
        bounds=BOUNDS,
        most_plans=arguments.plans,
        intervals=20,
        starts=1,
        refine=None,
    )
    for trial in found.trials:
        print(f"{trial.plans:3d} plans: T = {trial.T:.4f} s at {trial.values.round(3)}")
    print(found)
    arguments.out.mkdir(parents=True, exist_ok=True)
    slowest = max(found.solutions, key=lambda solution: solution.T)
    print(slowest.sensitivities.table(6))
    slowest.sensitivities.plot(arguments.out / "base_placement.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
