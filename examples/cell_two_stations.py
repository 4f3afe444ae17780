"""A UR5 moves two parts from a conveyor to a tray, in the order that takes least time.

The conveyor brings two parts at once and stops; the planner chooses the order of the
parts, and the position of each part on the tray. Each part is put down directly after
it was picked up; while it is carried, its mass and shape are part of the problem.
Gripping and releasing take 0.15 s each. Writes to out/ the whole cycle as CSV, a Gantt
picture and a page that plays offline.

    python examples/cell_two_stations.py [--out FOLDER] [--seed 0]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

import tominpmp as tm

HOME = np.array([0.0, -1.7, 1.9, -1.8, -1.57, 0.0])
TOOL = "tool0"
# The tool points down.
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
# Heights of conveyor and tray, size and positions of the parts [m].
BELT_TOP, TRAY_TOP = 0.10, 0.05
SIZE, MASS = (0.06, 0.06, 0.08), 1.0
PICKS = {"pick left": (0.45, 0.35), "pick right": (0.60, 0.35)}
PLACES = {"place left": (0.45, -0.35), "place right": (0.60, -0.35)}
GRIP = 0.15
# Distance of a gripped part from the surface below it [m].
GAP = 0.005


def part() -> tm.Payload:
    """A part below the tool."""
    x, y, z = SIZE
    inertia = MASS / 12.0 * np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2])
    middle = (0.0, 0.0, 0.5 * z)
    shape = tm.Box("part", size=SIZE, position=middle)
    return tm.Payload(
        MASS, TOOL, com=middle, inertia=inertia, geometry=[shape], name="part"
    )


def goal(place: tuple[float, float], top: float) -> tm.Goal:
    """The tool over a square part: four grasps are possible."""
    position = np.array([*place, top + SIZE[2] + GAP])
    turns = [pin.exp3(np.array([0.0, 0.0, k * np.pi / 2.0])) for k in range(4)]
    return tm.AnyGoal(
        [tm.PoseGoal(TOOL, pin.SE3(turn @ DOWN, position)) for turn in turns]
    )


def stations() -> list[tm.Station]:
    """Two stations to pick up parts, two to put them down."""
    load = part()
    found = [
        tm.Station(
            name,
            goal(place, BELT_TOP),
            dwell=GRIP,
            then=tuple(PLACES),
            payload=load,
        )
        for name, place in PICKS.items()
    ]
    return found + [
        tm.Station(name, goal(place, TRAY_TOP), dwell=GRIP)
        for name, place in PLACES.items()
    ]


def scene() -> tm.Scene:
    """Conveyor, tray, and a post between them."""
    belt = tm.Box("belt", size=(0.9, 0.25, BELT_TOP), position=(0.5, 0.35, 0.05))
    tray = tm.Box("tray", size=(0.4, 0.3, TRAY_TOP), position=(0.52, -0.35, 0.025))
    post = tm.Box("post", size=(0.05, 0.05, 0.25), position=(0.55, 0.0, 0.125))
    return tm.Scene([belt, tray, post])


def main() -> int:
    """Plan, report on the cycle, write the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    tour = tm.plan_tour(
        tm.load_robot("ur5", limits="urdf"),
        HOME,
        stations(),
        scene=scene(),
        margin=0.002,
        motion_limits=tm.MotionLimits(acceleration=8.0),
        # The controller that reads the file interpolates between its rows.
        control_period=0.004,
        seed=arguments.seed,
    )
    print(tour.message)
    if not tour.success:
        return 1
    print(tour.table())
    arguments.out.mkdir(parents=True, exist_ok=True)
    tour.plot(arguments.out / "cell_two_stations.png")
    tour.play(arguments.out / "cell_two_stations.html")
    tour.export(arguments.out / "cell_two_stations.csv", dt=0.004)
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"cell_two_stations.{ending}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
