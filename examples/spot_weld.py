"""UR5s set spot welds on the frame of a door, in the order that takes least time.

The electrode is on each spot along the normal of the sheet, and may spin freely about
its axis; it stays there for the duration of the weld. Order, configurations,
spins and motions are optimised together, from home to home, with the mass and the shape
of the gun in every motion. With two arms side by side each spot can be set by either
arm: the planner also chooses the arm for each weld, and the arms do not collide. Writes
to out/ the whole cycle as CSV, a Gantt picture and a page that plays offline.

    python examples/spot_weld.py [--out FOLDER] [--seed 0] [--spots 12] [--arms 2]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import tominpmp as tm

HOME = np.array([0.0, -2.0, 2.0, -0.0, 1.57, 0.0])
FLANGE = "tool0"
# The door in front of the arm: its plane, its centre and half of its width [m].
DOOR_X, MIDDLE, HALF = 0.66, 0.42, 0.25
THICKNESS, RAIL = 0.02, 0.06
# The gun: an electrode of this length, in the axis of the flange, and its transformer.
LENGTH, MASS = 0.20, 1.8
# Distance of electrode and sheet while the gun closes, and duration of a weld.
STANDOFF, WELD = 0.004, 0.35
ACCELERATION = 8.0
# Distance of each of two arms from the middle [m].
ASIDE = 0.34


def gun() -> tm.Payload:
    """The gun on the flange."""
    electrode = tm.Cylinder(
        "electrode", radius=0.012, length=LENGTH, position=(0, 0, 0.5 * LENGTH)
    )
    transformer = tm.Box(
        "transformer", size=(0.10, 0.07, 0.08), position=(0.05, 0, 0.05)
    )
    inertia = np.diag([0.006, 0.007, 0.004])
    return tm.Payload(
        MASS,
        FLANGE,
        com=(0.03, 0, 0.06),
        inertia=inertia,
        geometry=[electrode, transformer],
        name="gun",
    )


def spots() -> list[np.ndarray]:
    """Positions of the twelve welds in the plane of the door: y, z, along the frame."""
    rim = HALF - 0.5 * RAIL
    sill = [(y, MIDDLE - rim) for y in np.linspace(-rim, rim, 4)]
    belt = [(y, MIDDLE) for y in np.linspace(-rim, rim, 4)]
    roof = [(y, MIDDLE + rim) for y in np.linspace(-rim, rim, 4)]
    return [np.array(spot) for spot in (*sill, *belt, *roof)]


def stations(count: int, frames: tuple[str, ...] = (FLANGE,)) -> list[tm.Station]:
    """The welds: the electrode along the normal of the sheet (x), in any spin.

    Any of several arms may set a weld.
    """
    found = []
    for number, (y, z) in enumerate(spots()[:count], 1):
        before = DOOR_X - 0.5 * THICKNESS - STANDOFF - LENGTH
        goals = [
            tm.AxisGoal(frame, (0, 0, 1), (1, 0, 0), (before, y, z)) for frame in frames
        ]
        goal = goals[0] if len(goals) == 1 else tm.AnyGoal(goals)
        found.append(tm.Station(f"weld {number}", goal, dwell=WELD))
    return found


def door() -> tm.Scene:
    """Sheet below the belt line, and a window above it."""
    rim = HALF - 0.5 * RAIL
    wide, high = 2.0 * HALF, HALF - 0.5 * RAIL

    def sheet(name: str, y: float, z: float, width: float, height: float) -> tm.Box:
        return tm.Box(name, size=(THICKNESS, width, height), position=(DOOR_X, y, z))

    return tm.Scene(
        [
            sheet("lower sheet", 0.0, MIDDLE - 0.5 * HALF, wide, HALF + RAIL),
            sheet("roof rail", 0.0, MIDDLE + rim, wide, RAIL),
            sheet("left pillar", rim, MIDDLE + 0.5 * high, RAIL, high),
            sheet("right pillar", -rim, MIDDLE + 0.5 * high, RAIL, high),
        ]
    )


def welders(arms: int) -> tuple[tm.Robot, np.ndarray, tuple[str, ...]]:
    """One arm or two side by side, their start configurations, and their flanges."""
    arm = tm.load_robot("ur5", limits="urdf").with_payload(gun())
    if arms == 1:
        return arm, HOME, (FLANGE,)
    places = {"left": (0.0, ASIDE, 0.0), "right": (0.0, -ASIDE, 0.0)}
    both = tm.combine_robots([(name, arm, place) for name, place in places.items()])
    flanges = tuple(f"{name}/{FLANGE}" for name in places)
    return both, both.stack(**dict.fromkeys(places, HOME)), flanges


def tour(count: int = 12, seed: int = 0, arms: int = 1) -> tm.Tour:
    """Plan the cycle."""
    robot, home, flanges = welders(arms)
    return tm.plan_tour(
        robot,
        home,
        stations(count, flanges),
        scene=door(),
        margin=0.002,
        motion_limits=tm.MotionLimits(acceleration=ACCELERATION),
        seed=seed,
    )


def main() -> int:
    """Plan, report on the cycle, write the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--spots", type=int, default=12, choices=range(2, 13), metavar="2..12"
    )
    parser.add_argument("--arms", type=int, default=1, choices=(1, 2))
    arguments = parser.parse_args()
    found = tour(arguments.spots, arguments.seed, arguments.arms)
    print(found.message)
    if not found.success:
        return 1
    print(found.table())
    welding = WELD * arguments.spots
    word = "of which welding" if arguments.arms == 1 else "for welds of together"
    print(f"cycle {found.cycle_time:.3f} s, {word} {welding:.2f} s")
    arguments.out.mkdir(parents=True, exist_ok=True)
    found.plot(arguments.out / "spot_weld.png")
    found.play(arguments.out / "spot_weld.html")
    found.export(arguments.out / "spot_weld.csv")
    for ending in ("png", "html", "csv"):
        print(arguments.out / f"spot_weld.{ending}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
