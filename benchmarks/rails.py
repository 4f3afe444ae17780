"""A mass on a rail with limits of speed, acceleration, jerk and torque rate.

From rest to rest the minimum times have closed forms: at most seven phases of constant
jerk. Distances and limits are drawn at random, for every combination of limits.

    python -m benchmarks.rails
    python -m benchmarks.rails --count 10 --seed 1 --control spline
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import math
import statistics
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import tominpmp as tm

RAIL = """<robot name="rail"><link name="base"/>
<link name="mass"><inertial><mass value="{mass}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="mass"/>
<axis xyz="1 0 0"/>
<limit lower="-100" upper="100" effort="{effort}" velocity="{velocity}"/></joint>
</robot>"""
# No limit in a description: far larger than these motions need.
MUCH = 1e4
KINDS = {
    "acceleration": ("acceleration",),
    "jerk": ("jerk",),
    "torque rate": ("effort_rate",),
    "acceleration, jerk": ("acceleration", "jerk"),
    "speed, acceleration": ("velocity", "acceleration"),
    "speed, jerk": ("velocity", "jerk"),
    "seven phases": ("velocity", "acceleration", "jerk"),
    "torque, torque rate": ("effort", "effort_rate"),
    "speed, torque, torque rate": ("velocity", "effort", "effort_rate"),
}
COLUMNS = (
    "limits",
    "number",
    "distance",
    "velocity",
    "acceleration",
    "jerk",
    "status",
    "verified",
    "intervals",
    "T",
    "minimum",
    "excess",
    "seconds",
)


def minimum_time(
    distance: float,
    velocity: float = math.inf,
    acceleration: float = math.inf,
    jerk: float = math.inf,
) -> float:
    """Least time from rest to rest along a line [s].

    Args:
        distance: Distance [m].
        velocity: Largest speed [m/s].
        acceleration: Largest acceleration [m/s^2].
        jerk: Largest jerk [m/s^3]. Acceleration or jerk is finite.
    """
    top = velocity
    # Accelerating to a speed and braking takes this time, at half the speed on average.
    if not math.isfinite(top) or top * _rise(top, acceleration, jerk) > distance:
        low, high = 0.0, 1.0
        while high * _rise(high, acceleration, jerk) < distance:
            high *= 2.0
        for _ in range(200):
            top = 0.5 * (low + high)
            enough = top * _rise(top, acceleration, jerk) >= distance
            low, high = (low, top) if enough else (top, high)
    return _rise(top, acceleration, jerk) + distance / top


def _rise(speed: float, acceleration: float, jerk: float) -> float:
    """Time from rest to a speed, with no acceleration at either end [s]."""
    if speed >= acceleration * acceleration / jerk:
        return speed / acceleration + acceleration / jerk
    return 2.0 * math.sqrt(speed / jerk)


def draw(kind: str, rng: np.random.Generator) -> dict[str, float]:
    """Distance, mass and limits, drawn so that all limits become active."""
    drawn = {"distance": float(rng.uniform(0.3, 3.0)), "mass": rng.uniform(0.5, 5.0)}
    mass, names = drawn["mass"], KINDS[kind]
    T = float(rng.uniform(0.5, 3.0))
    mean = drawn["distance"] / T
    if "jerk" in names or "effort_rate" in names:
        drawn["jerk"] = 32.0 * drawn["distance"] / T**3
    if "acceleration" in names or "effort" in names:
        # Jerk alone leads to 8 d / T^2.
        drawn["acceleration"] = float(rng.uniform(4.5, 7.0)) * mean / T
    if "velocity" in names:
        drawn["velocity"] = float(rng.uniform(1.1, 1.7)) * mean
    if "effort_rate" in names:
        drawn["effort_rate"] = drawn["jerk"] * mass
    if "effort" in names:
        drawn["effort"] = drawn["acceleration"] * mass
    return drawn


def problem(kind: str, drawn: dict[str, float]) -> tm.Problem:
    """The problem with the limits of its kind."""
    description = RAIL.format(
        mass=drawn["mass"],
        effort=drawn.get("effort", MUCH * drawn["mass"]),
        velocity=drawn.get("velocity", MUCH),
    )
    kept = ("acceleration", "jerk", "effort_rate")
    limits: dict[str, Any] = {name: drawn[name] for name in kept if name in KINDS[kind]}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rail.urdf"
        path.write_text(description, encoding="utf-8")
        robot = tm.load_robot(path)
    return tm.Problem(
        robot,
        [0.0],
        tm.JointGoal([drawn["distance"]]),
        motion_limits=tm.MotionLimits(**limits),
    )


def measure(kind: str, number: int, seed: int, control: Any) -> dict[str, object]:
    """Plan one motion: a row of the sheet."""
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    drawn = draw(kind, rng)
    limits = {key: drawn.get(key, math.inf) for key in COLUMNS[3:6]}
    begin = time.process_time()
    solution = tm.plan(problem(kind, drawn), control=control)
    seconds = time.process_time() - begin
    minimum = minimum_time(drawn["distance"], **limits)
    motion = solution.trajectory
    row = (
        kind,
        number,
        drawn["distance"],
        *limits.values(),
        solution.status.name,
        solution.success,
        0 if motion is None else motion.t.size - 1,
        solution.T,
        minimum,
        solution.T / minimum - 1.0,
        seconds,
    )
    return dict(zip(COLUMNS, row, strict=True))


def main() -> int:
    """Measure, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--control", default="auto")
    parser.add_argument("--csv", type=Path, default=Path("out/rails.csv"))
    arguments = parser.parse_args()
    sheet, lines = Sheet(arguments.csv, COLUMNS), []
    for kind in KINDS:
        for number in range(arguments.count):
            sheet.add(measure(kind, number, arguments.seed, arguments.control))
    for kind in (*KINDS, "all"):
        where = {} if kind == "all" else {"limits": kind}
        excess = sheet.column("excess", **where)
        verified = sheet.column("verified", **where)
        lines.append(
            (
                kind,
                f"{sum(verified)} / {len(verified)}",
                f"{100 * statistics.median(excess):+.3f} %",
                f"{100 * min(excess):+.3f} %",
                f"{100 * max(excess):+.3f} %",
                statistics.median(sheet.column("seconds", **where)),
            )
        )
    header = (
        "limits",
        "verified",
        "T relative to the minimum: median",
        "least",
        "largest",
        "s",
    )
    print(markdown(header, lines))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
