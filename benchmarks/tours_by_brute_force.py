"""Tours beside the best of all orders and configurations, with planned legs.

Every leg between any two configurations is planned, and the best of all orders and
configurations is taken; `tm.plan_tour` is to find a tour that is as fast, from no more
plans. The arm is the planar one of three joints, ruled by its torques.

    python -m benchmarks.tours_by_brute_force [--stations 3] [--seeds 1]
"""

# ruff: noqa: E402 (the environment must be set before numerical libraries load)
from __future__ import annotations

from benchmarks.sheet import one_thread

one_thread()

import argparse
import time
from itertools import pairwise, permutations, product

import numpy as np

import tominpmp as tm

# Configurations are up to so far from home, joint by joint [rad].
HOME, REACH = np.array([0.5, 1.2, -0.7]), 1.2
FEW = {"intervals": 12, "refine": None, "starts": 1, "effort": "quick"}


def choices(robot: tm.Robot, count: int, seed: int) -> list[list[np.ndarray]]:
    """Two configurations for each station, within limits and clear of itself."""
    rng = np.random.default_rng(seed)
    lower = np.maximum(HOME - REACH, robot.limits.position_lower)
    upper = np.minimum(HOME + REACH, robot.limits.position_upper)

    def drawn() -> np.ndarray:
        while True:
            q = rng.uniform(lower, upper)
            try:
                tm.Problem(robot, HOME, tm.JointGoal(q))
            except tm.ProblemError:
                continue
            return q

    return [[drawn(), drawn()] for _ in range(count)]


def brute_force(robot: tm.Robot, at: list[list[np.ndarray]]) -> tuple[float, int]:
    """The best of all, and how many legs were planned."""
    places = {(0, 0): HOME}
    places |= {(k, c): q for k, rows in enumerate(at, 1) for c, q in enumerate(rows)}
    times = {}
    for (a, q), (b, p) in permutations(places.items(), 2):
        if a[0] != b[0]:
            problem = tm.Problem(robot, q, tm.JointGoal(p))
            times[a, b] = tm.plan(problem, **FEW).T
    best = np.inf
    for order in permutations(range(1, len(at) + 1)):
        for chosen in product(range(2), repeat=len(at)):
            way = [(0, 0), *zip(order, chosen, strict=True), (0, 0)]
            best = min(best, sum(times[leg] for leg in pairwise(way)))
    return best, len(times)


def main() -> int:
    """Compare, and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stations", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=1)
    arguments = parser.parse_args()
    robot, worst = tm.load_robot("planar3r"), 0.0
    for seed in range(arguments.seeds):
        at = choices(robot, arguments.stations, seed)
        begin = time.process_time()
        best, plans = brute_force(robot, at)
        middle = time.process_time()
        goals = [tm.AnyGoal([tm.JointGoal(q) for q in rows]) for rows in at]
        tour = tm.plan_tour(robot, HOME, goals, exact=True, **FEW)
        end = time.process_time()
        ratio = tour.cycle_time / best
        worst = max(worst, ratio)
        print(
            f"seed {seed}: best of all {best:.4f} s from {plans} plans in "
            f"{middle - begin:.1f} s; tour {tour.cycle_time:.4f} s ({ratio:.4f}) from "
            f"{tour.legs_planned} plans in {end - middle:.1f} s; bound "
            f"{tour.lower_bound:.4f} s",
            flush=True,
        )
    return 0 if worst <= 1.0 + 1e-3 else 1


if __name__ == "__main__":
    raise SystemExit(main())
