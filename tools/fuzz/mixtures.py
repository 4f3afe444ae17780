"""Random combinations of options, valid and not, with tiny problems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

import tominpmp as tm

LIMIT = 2.0
VALUES: dict[str, tuple[Any, ...]] = {
    "method": ("auto", "inverse", "collocation", "adjoint", "penalty", "nonsense"),
    "intervals": (4, 5, 8, 13, 3, 10**6),
    "grid": ("cosine", "uniform"),
    "control": ("auto", "constant", "linear", "spline"),
    "objective": ("time", "feasible"),
    "slack": (None, 0.0, 0.05, 10.0, 11.0),
    "refine": (None, "grid", "switching"),
    "smoothing": (None, 0.0, 1e-4, 1.0, 1e9),
    "starts": (None, 1, 2, 3, 0),
    "seed": (0, 1, 2**40, -1),
    "max_iterations": (1, 3, 20),
    "tolerance": (1e-4, 1.0, 1e-300, 1e9),
    "feasibility": (1e-6, 1e-2, 1e-300),
    "goal_tolerance": (1e-3, 1e-9, 1.0),
    "trust_region": (0.3, 1e-6, 1e9, 1e-300),
    "step_rule": ("adaptive", "paper"),
    "control_step": (0.05, 1e-12, 1e9),
    "time_step": (0.01, 1e-12, 1e9),
    "initial_duration": (None, 1.0, 1e-9, 1e9),
    "lp_solver": ("auto", "highs", "piqp", "nonsense"),
    "control_period": (None, 0.001, 0.01, 1e-9, 1e3),
    "callback": (None, lambda _: None, lambda _: True, lambda _: "x"),
}


class Mixtures:
    """Plans with random options, by number."""

    def __init__(self) -> None:
        self.robot = tm.load_robot("planar3r")
        self.known = set(tm.Options.names())

    def run(self, rng: np.random.Generator) -> tuple[str, Callable[[], Any]]:
        """Choose a problem and options.

        Returns:
            What they are, and the call that plans.
        """
        chosen = rng.choice(sorted(VALUES), size=int(rng.integers(1, 6)), replace=False)
        options: dict[str, Any] = {"intervals": 6, "max_planning_time": LIMIT}
        for name in chosen.tolist():
            if name in self.known:
                values = VALUES[name]
                options[name] = values[rng.integers(len(values))]
        problem, what = self._problem(rng)
        label = ", ".join(f"{k}={v}" for k, v in options.items())
        return f"plan({what}; {label})", lambda: self._plan(problem, options)

    def _plan(self, problem: Callable[[], tm.Problem], options: dict[str, Any]) -> None:
        solution = tm.plan(problem(), tm.Options(**options))
        if bool(solution) != solution.success or (solution and solution.T <= 0.0):
            raise AssertionError(f"{solution!r} contradicts itself")
        if solution and not np.all(np.isfinite(solution.trajectory.q)):
            raise AssertionError(f"{solution!r} has positions that are no numbers")

    def _problem(self, rng: np.random.Generator) -> tuple[Callable[[], Any], str]:
        limits = self.robot.limits
        low, high = limits.position_lower, limits.position_upper
        start, end = (rng.uniform(low, high) for _ in range(2))
        kind = int(rng.integers(5))
        goals: tuple[Callable[[], tm.Goal], ...] = (
            lambda: tm.JointGoal(end),
            lambda: tm.JointGoal(start),
            lambda: tm.JointRegionGoal(end, tolerance=0.2),
            lambda: tm.PositionGoal("tip", (*rng.uniform(-4.0, 4.0, 2), 0.0)),
            lambda: tm.PoseGoal("tip", pin.SE3.Random()),
        )
        robot, scene = self.robot, []
        if rng.random() < 0.4:
            place = (*rng.uniform(-5.0, 5.0, 2), 0.0)
            motion = tm.ConstantVelocity((0.1, 0, 0)) if rng.random() < 0.3 else None
            scene = [tm.Sphere("o", radius=0.3, position=place, motion=motion)]
        if rng.random() < 0.2:
            scale = float(rng.choice([1e-6, 1e-3, 1e3, 1e6]))
            robot = robot.with_changes(effort=scale * limits.effort_upper)
        return (
            lambda: tm.Problem(robot, start, goals[kind](), tm.Scene(scene)),
            f"goal {kind}, {len(scene)} obstacles",
        )
