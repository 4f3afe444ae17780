"""Tours compared with the best of all orders and configurations, with planned legs.

Every leg between any two configurations is planned with `tm.plan`, and the best of
all orders and configurations is found by dynamic programming over sets, without code
of the tour planner. `tm.plan_tour` must find an equally fast tour, with no more plans.
The arms are the planar arm with three joints, limited by its torques,
and a UR5, limited by its speeds; limits of acceleration can be added.

    python -m benchmarks.tours_by_brute_force [--stations 3] [--seeds 1]
    python -m benchmarks.tours_by_brute_force --arm ur5 --stations 7 8
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import Sheet, markdown, one_thread

one_thread()

import argparse
import time
from itertools import permutations
from pathlib import Path

import numpy as np

import tominpmp as tm

# Largest distance of configurations from home, joint by joint [rad].
HOMES = {"planar3r": (0.5, 1.2, -0.7), "ur5": (0.0, -1.2, 1.4, -1.7, -1.5, 0.0)}
REACH = 1.2
FEW = {"intervals": 12, "refine": None, "starts": 1, "effort": "quick"}
# Excess over the optimum that counts as equal: two plans of one leg differ by this.
EQUAL = 1e-3
COLUMNS = (
    "arm",
    "stations",
    "seed",
    "best",
    "tour",
    "tour_in_table",
    "tour / best",
    "bound",
    "plans_all",
    "plans_tour",
    "seconds_all",
    "seconds_tour",
)

# A node and one of its configurations; home is (0, 0).
Place = tuple[int, int]


def choices(
    robot: tm.Robot, home: np.ndarray, count: int, seed: int
) -> list[list[np.ndarray]]:
    """Two configurations for each station, within limits, without self-collision."""
    rng = np.random.default_rng(seed)
    lower = np.maximum(home - REACH, robot.limits.position_lower)
    upper = np.minimum(home + REACH, robot.limits.position_upper)

    def drawn() -> np.ndarray:
        while True:
            q = rng.uniform(lower, upper)
            try:
                tm.Problem(robot, home, tm.JointGoal(q))
            except tm.ProblemError:
                continue
            return q

    return [[drawn(), drawn()] for _ in range(count)]


def times_of_legs(
    robot: tm.Robot,
    home: np.ndarray,
    at: list[list[np.ndarray]],
    limits: tm.MotionLimits | None,
) -> dict[tuple[Place, Place], float]:
    """Durations of all legs, planned one by one [s]."""
    places: dict[Place, np.ndarray] = {(0, 0): home}
    places |= {(k, c): q for k, rows in enumerate(at, 1) for c, q in enumerate(rows)}
    times = {}
    for (a, q), (b, p) in permutations(places.items(), 2):
        if a[0] != b[0]:
            problem = tm.Problem(
                robot, q, tm.JointGoal(p), motion_limits=limits, self_collision=False
            )
            times[a, b] = tm.plan(problem, **FEW).T
    return times


def best_of_all(times: dict[tuple[Place, Place], float], stations: int) -> float:
    """The minimum time of all orders and configurations, from home to home [s].

    The state is the set of visited stations and the configuration at the last of them:
    the rest of the tour depends on this state alone.
    """
    home: Place = (0, 0)
    places = sorted({a for a, _ in times} - {home})
    best = {(frozenset([p[0]]), p): times[home, p] for p in places}
    for _ in range(stations - 1):
        longer: dict[tuple[frozenset[int], Place], float] = {}
        for (seen, last), spent in best.items():
            for p in places:
                if p[0] not in seen:
                    key = seen | {p[0]}, p
                    total = spent + times[last, p]
                    longer[key] = min(total, longer.get(key, np.inf))
        best = longer
    return min(spent + times[last, home] for (_, last), spent in best.items())


def in_table(
    tour: tm.Tour,
    at: list[list[np.ndarray]],
    times: dict[tuple[Place, Place], float],
) -> float:
    """Duration of a tour by the durations of the legs planned one by one [s]."""
    here: Place = (0, 0)
    total = 0.0
    for visit in tour.visits:
        k = int(visit.station.removeprefix("s"))
        apart = [float(np.max(np.abs(q - visit.q))) for q in at[k - 1]]
        there = k, int(np.argmin(apart))
        total, here = total + times[here, there], there
    return total + times[here, (0, 0)]


def compare(name: str, count: int, seed: int, limit: float | None) -> dict[str, object]:
    """Row with the optimum and the result of the tour planner."""
    robot, home = tm.load_robot(name, limits="urdf"), np.array(HOMES[name])
    limits = None if limit is None else tm.MotionLimits(acceleration=limit)
    at = choices(robot, home, count, seed)
    begin = time.process_time()
    times = times_of_legs(robot, home, at, limits)
    best = best_of_all(times, count)
    middle = time.process_time()
    goals = [tm.AnyGoal([tm.JointGoal(q) for q in rows]) for rows in at]
    stations = {f"s{k}": goal for k, goal in enumerate(goals, 1)}
    tour = tm.plan_tour(
        robot,
        home,
        stations,
        motion_limits=limits,
        self_collision=False,
        exact=True,
        **FEW,
    )
    end = time.process_time()
    values = (
        f"{name}, {limit:g} rad/s²" if limit else name,
        count,
        seed,
        best,
        tour.cycle_time,
        in_table(tour, at, times),
        f"{tour.cycle_time / best:.5f}",
        tour.lower_bound,
        len(times),
        tour.legs_planned,
        middle - begin,
        end - middle,
    )
    return dict(zip(COLUMNS, values, strict=True))


def main() -> int:
    """Compare, write the CSV file, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arm", choices=HOMES, default="planar3r")
    parser.add_argument("--stations", type=int, nargs="+", default=[3])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--acceleration", type=float, help="limit of all joints")
    parser.add_argument("--csv", type=Path, default=Path("out/tours.csv"))
    arguments = parser.parse_args()
    sheet = Sheet(arguments.csv, COLUMNS)
    for count in arguments.stations:
        for seed in range(arguments.seeds):
            row = compare(arguments.arm, count, seed, arguments.acceleration)
            sheet.add(row)
    print(markdown(COLUMNS, [list(row.values()) for row in sheet.rows]))
    slowest = max(max(r["tour"], r["tour_in_table"]) / r["best"] for r in sheet.rows)
    return 0 if slowest <= 1.0 + EQUAL else 1


if __name__ == "__main__":
    raise SystemExit(main())
