"""A UR5 drills 25 holes of a tilted plate, in the order that takes least time.

Each hole is a station: the drill is in front of it, along its axis, and may spin freely
about this axis; the arm may reach it with several configurations, too. It stays there
for 0.3 s. Order, configurations and motions are optimised together, from home
to home. Writes to out/ the whole cycle as CSV, a Gantt picture and a page that plays
offline.

    python examples/drilling.py [--out FOLDER] [--seed 0] [--rows 5]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

HOME = np.array([0.0, -1.8, 2.2, -2.0, -1.6, 0.0])
TIP = "tool0"
# The plate: its centre, its tilt about y, and the distance of the holes.
MIDDLE, TILT, SPACING = np.array([0.6, 0.0, 0.25]), 0.5, 0.05
THICKNESS = 0.02
# Distance of the tip from the plate at a stop, and duration of the stop.
STANDOFF, DWELL = 0.01, 0.3
ACCELERATION = 8.0


def rotation() -> np.ndarray:
    """Axes of the plate, the last one normal to it."""
    c, s = np.cos(TILT), np.sin(TILT)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def stations(rows: int) -> list[tm.Station]:
    """The holes, row by row."""
    axes, found = rotation(), []
    offsets = SPACING * (np.arange(rows) - 0.5 * (rows - 1))
    for i, x in enumerate(offsets):
        for j, y in enumerate(offsets):
            above = 0.5 * THICKNESS + STANDOFF
            place = MIDDLE + axes @ np.array([x, y, above])
            goal = tm.AxisGoal(TIP, (0, 0, 1), -axes[:, 2], place)
            found.append(tm.Station(f"hole {i + 1}{j + 1}", goal, dwell=DWELL))
    return found


def main() -> int:
    """Plan, report on the cycle, write the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", type=int, default=5)
    arguments = parser.parse_args()
    size = (arguments.rows + 1) * SPACING
    plate = tm.Box(
        "plate", size=(size, size, THICKNESS), position=MIDDLE, rotation=rotation()
    )
    tour = tm.plan_tour(
        tm.load_robot("ur5", limits="urdf"),
        HOME,
        stations(arguments.rows),
        scene=tm.Scene([plate]),
        margin=0.001,
        motion_limits=tm.MotionLimits(acceleration=ACCELERATION),
        seed=arguments.seed,
    )
    print(tour.message)
    if not tour.success:
        return 1
    print(tour.table())
    print(f"cycle {tour.cycle_time:.3f} s, {tour.direct} of {len(tour.motions)} legs")
    print("as fast as limits of speed and acceleration allow")
    arguments.out.mkdir(parents=True, exist_ok=True)
    tour.plot(arguments.out / "drilling.png")
    tour.play(arguments.out / "drilling.html")
    tour.export(arguments.out / "drilling.csv", dt=0.004)
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"drilling.{ending}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
