"""A Panda reaches into a shelf for a can, with one of several configurations.

The goal is a pose of the hand: the library chooses the configuration, and the path past
the boards. It tries several configurations and keeps the
fastest verified motion. Writes to out/ a figure, a page that plays offline and the
motion.

    python examples/panda_shelf.py [--out FOLDER] [--seed 0] [--starts 4]

The same problem is in examples/scenarios/panda_shelf.toml, for `tominpmp plan`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import tominpmp as tm

SCENARIO = Path(__file__).parent / "scenarios" / "panda_shelf.toml"


def main() -> int:
    """Plan, report on the starts, write the figure, the page and the motion."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--starts", type=int, default=None)
    arguments = parser.parse_args()
    task = tm.load_scenario(SCENARIO).problem
    options = tm.Options(seed=arguments.seed, starts=arguments.starts)
    solution = tm.plan(task, options)
    print(solution.message)
    if solution.trajectory is None:
        return 1
    ends = {record.start: record for record in solution.history}
    for start, record in ends.items():
        print(
            f"  start {start + 1}: T = {record.duration:.4f} s, "
            f"violation {record.violation:.1e}"
        )
    print(solution.prove_clearance().message)
    arguments.out.mkdir(parents=True, exist_ok=True)
    solution.plot(arguments.out / "panda_shelf.png")
    solution.play(arguments.out / "panda_shelf.html", ghosts=4)
    solution.export(arguments.out / "panda_shelf.csv", dt=0.001)
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"panda_shelf.{ending}")
    return 0 if solution.success else 1


if __name__ == "__main__":
    raise SystemExit(main())
