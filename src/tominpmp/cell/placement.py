"""Moves the base of a robot, obstacles or goals to where tasks take less time.

Every plan yields the derivatives of its duration by all placements, so that one plan
of each task gives a descent direction. A quasi-Newton method within bounds makes the
steps; the plans of a step are warm-started with the motions of the previous one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import BFGS, minimize

from tominpmp.arrays import Array, Record, array_or_nan, frozen_array
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import FARTHEST, instance, vector, whole, wrong
from tominpmp.combined_robots import base_placement
from tominpmp.exceptions import ProblemError, TominpmpError, naming
from tominpmp.goals.turns import TURN
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene
from tominpmp.sensitivities.records import Sensitivities
from tominpmp.solution import Solution
from tominpmp.status import Status

TRANSLATIONS, ROTATIONS = ("x", "y", "z"), ("roll", "pitch", "yaw")
COORDINATES = TRANSLATIONS + ROTATIONS
BASE, GOALS = "base", "goals"


def robot_at(robot: Robot, base: Any) -> Robot:
    """The robot with its base somewhere else in the world.

    Args:
        robot: The robot.
        base: Placement base_to_world of the root of its description: a pose in any
            accepted form, or a position, shape (3,) [m].

    Raises:
        ProblemError: If an argument is of another type.
    """
    instance(robot, Robot, "robot")
    placement = base_placement(robot.name, base, "base")
    return robot._described(robot.description.on_base(placement))


@dataclass(frozen=True, eq=False)
class Moves:
    """Dependence of the problems of tasks on the coordinates of a placement.

    Attributes:
        moved: "base", "goals", or names of obstacles.
        names: Names of the coordinates that are free.
        robot: The robot.
        base: Placement of its base where all coordinates are zero.
    """

    moved: str | tuple[str, ...]
    names: tuple[str, ...]
    robot: Robot
    base: pin.SE3

    def placement(self, x: Array) -> pin.SE3:
        """Placement of the base, or displacement of goals or obstacles.

        Args:
            x: The coordinates, shape (k,) [m or rad]; the base turns about its origin.
        """
        twist = self._twist(x)
        if self.moved != BASE:
            return pin.SE3(np.eye(3), twist[:3])
        rotation = pin.exp3(twist[3:]) @ self.base.rotation
        return pin.SE3(rotation, self.base.translation + twist[:3])

    def _twist(self, x: Array) -> Array:
        twist = np.zeros(6)
        twist[[COORDINATES.index(name) for name in self.names]] = x
        return twist

    def mover(self, x: Array) -> Callable[[Problem], Problem]:
        """The function that applies a placement to a task.

        The function raises a TominpmpError if the task is impossible there: a start
        that collides, say.
        """
        placement = self.placement(x)
        shift = np.array(placement.translation)
        if self.moved == BASE:
            # Tasks share a robot, whose meshes are read once.
            robot = robot_at(self.robot, placement)
            return lambda task: replace(task, robot=robot)
        if self.moved == GOALS:
            return lambda task: replace(task, goal=task.goal.moved(shift))

        def with_obstacles(task: Problem) -> Problem:
            scene = [
                replace(item, position=item.position + shift)
                if item.name in self.moved
                else item
                for item in task.scene
            ]
            return replace(task, scene=Scene(scene))

        return with_obstacles

    def gradient(self, sensitivities: Sensitivities, x: Array) -> Array:
        """Derivative of the duration of a task by the coordinates [s/m or s/rad].

        Args:
            sensitivities: Derivatives of the duration, as shares of it.
            x: The coordinates, shape (k,) [m or rad].
        """
        slopes = np.zeros(6)
        if self.moved == BASE:
            base, twist = sensitivities.base, self._twist(x)
            # The base turns about its own origin, sensitivities are about the world's.
            about_base = base[3:] - np.cross(self.placement(x).translation, base[:3])
            slopes[:3] = base[:3]
            slopes[3:] = pin.Jexp3(-twist[3:]).T @ about_base
        else:
            kind = "goal" if self.moved == GOALS else "obstacle"
            for item in sensitivities.of(kind):
                moves = kind == "goal" or item.subject in self.moved
                if moves and item.vector is not None:
                    slopes[:3] += item.vector
        free = slopes[[COORDINATES.index(name) for name in self.names]]
        return np.asarray(sensitivities.T * free)


# Initial and least trust-region radius, as shares of the range of the bounds.
FIRST_RADIUS, LEAST_RADIUS = 0.15, 2e-3
# Predicted reduction, as a share of the time, below which the search stops.
LEAST_REDUCTION = 5e-4
# Factors of the trust-region radius after good and bad steps.
GROW, SHRINK = 1.7, 0.35


@dataclass(frozen=True, eq=False)
class Trial(Record):
    """A placement that was tried.

    Attributes:
        values: The coordinates, shape (k,) [m or rad].
        T: Sum of the weighted durations of the tasks [s]; infinite if a task has no
            motion there, or no sensitivities.
        plans: Number of plans made up to this trial, its own included.
    """

    values: Array
    T: float
    plans: int


@dataclass(frozen=True, eq=False)
class ImprovedPlacement(Record):
    """The best placement that was found.

    Attributes:
        names: Names of the coordinates.
        values: Their values: displacements from the initial placement, shape (k,)
            [m or rad].
        placement: Placement base_to_world of the base; of obstacles and goals, their
            displacement.
        T: Sum of the weighted durations of the tasks [s].
        T_before: The same sum at the initial placement [s].
        plans: Number of plans made.
        trials: All placements that were tried, in the order of the search.
        solutions: The motions of the tasks; their problems have the placement.
    """

    names: tuple[str, ...]
    values: Array
    placement: pin.SE3 = field(repr=False)
    T: float
    T_before: float
    plans: int
    trials: tuple[Trial, ...] = field(repr=False)
    solutions: tuple[Solution, ...] = field(repr=False, compare=False)


@on_one_thread
def improve_placement(
    robot: Robot,
    tasks: Sequence[Problem],
    *,
    base: Any = None,
    bounds: Mapping[str, tuple[float, float]],
    moves: str | Sequence[str] = BASE,
    weights: Sequence[float] | None = None,
    most_plans: int = 100,
    options: Options | None = None,
    **changes: Any,
) -> ImprovedPlacement:
    """Move the base of a robot, or something around it, so that tasks take less time.

    ::

        better = tm.improve_placement(
            robot, tasks, bounds={"x": (-0.3, 0.3), "yaw": (-0.5, 0.5)}
        )
        print(better.placement, better.T_before, better.T)

    The start configurations of tasks do not change; if the base moves, goals on frames
    and obstacles keep their places in the world. The search is local: it descends to
    the nearest optimum.

    Args:
        robot: The robot.
        tasks: The problems to be planned, of one segment each, in which ``robot`` is
            put at the base.
        base: Initial placement base_to_world of the base, or its position, shape (3,)
            [m]; None for the origin of the world.
        bounds: Ranges (lower, upper) about zero of the coordinates that may change
            [m or rad], by their names: "x", "y", "z", and for the base "roll", "pitch",
            "yaw" about its own origin.
        moves: The things to move: "base", "goals" (all of them), or names of obstacles.
        weights: Number of times that each task is done; None for once each.
        most_plans: Number of plans after which no further step is made.
        options: Options of the plans.
        **changes: Options by name, which take precedence over ``options``.

    Returns:
        The best placement found, at worst the initial one.

    Raises:
        ProblemError: If an argument is wrong, or a task has no motion at the initial
            placement.
        OptionsError: If an option is wrong.
        KeyboardInterrupt: If Ctrl-C or the callback ended a plan.
    """
    instance(robot, Robot, "robot")
    problems, low, high = _checked(tasks, bounds)
    names, count = tuple(bounds), len(problems)
    moved = _moved(moves, problems, names)
    place = base_placement(robot.name, np.zeros(3) if base is None else base, "base")
    scale = np.ones(count) if weights is None else array_or_nan(weights)
    if scale.shape != (count,) or not np.all(np.isfinite(scale) & (scale > 0.0)):
        raise wrong(weights, "weights", f"{count} positive numbers, one a task")
    most_plans = whole(most_plans, "most_plans", least=1, expected="a number >= 1")
    options = Options.of(options).changed(changes)
    search = _Search(Moves(moved, names, robot, place), problems, scale, options)
    return search.run(low, high, most_plans)


def _checked(tasks: Any, bounds: Any) -> tuple[list[Problem], Array, Array]:
    expected = "problems of one segment, one or more"
    if isinstance(tasks, Problem) or not isinstance(tasks, Sequence) or not tasks:
        raise wrong(tasks, "tasks", expected)
    for number, task in enumerate(tasks):
        if not isinstance(task, Problem) or task.segments:
            raise wrong(task, f"tasks[{number}]", expected)
    if not isinstance(bounds, Mapping) or not bounds:
        raise wrong(bounds, "bounds", "ranges by the names of coordinates")
    rows = []
    for name, pair in bounds.items():
        expected = f"a range about zero of one of {', '.join(COORDINATES)} [m or rad]"
        most = FARTHEST if name in TRANSLATIONS else 1.01 * TURN
        row = vector(pair, f"bounds[{name!r}]", expected, 2, most=most)
        if name not in COORDINATES or not row[0] <= 0.0 <= row[1] or row[0] == row[1]:
            raise wrong(pair, f"bounds[{name!r}]", expected)
        rows.append(row)
    table = np.array(rows)
    return list(tasks), table[:, 0], table[:, 1]


def _of_task(number: int, count: int) -> AbstractContextManager[None]:
    """Context manager that attributes errors within it to a task."""
    return naming(f"tasks: number {number + 1} of {count}", f"tasks[{number}]")


def _moved(
    moves: Any, tasks: Sequence[Problem], names: Sequence[str]
) -> str | tuple[str, ...]:
    """Check the choice of things to move; goals are checked when they are moved."""
    if isinstance(moves, str) and moves == BASE:
        return BASE
    if not set(names) <= set(TRANSLATIONS):
        expected = f"some of {', '.join(TRANSLATIONS)}: only the base can be rotated"
        raise wrong(names, "bounds", expected)
    if isinstance(moves, str) and moves == GOALS:
        return GOALS
    chosen = (moves,) if isinstance(moves, str) else moves
    known = {item.name: item for task in tasks for item in task.scene}
    resting = [name for name, item in known.items() if item.motion is None]
    obstacles = list(chosen) if isinstance(chosen, Sequence) else []
    if not obstacles or any(name not in resting for name in obstacles):
        there = ", ".join(resting) or "there are none"
        raise wrong(moves, "moves", f"'base', 'goals' or obstacles at rest: {there}")
    return tuple(obstacles)


@dataclass(eq=False)
class _Search:
    """Quasi-Newton method with a trust region within bounds."""

    moves: Moves
    tasks: list[Problem]
    weights: Array
    options: Options
    plans: int = 0
    trials: list[Trial] = field(default_factory=list)

    def run(self, low: Array, high: Array, most_plans: int) -> ImprovedPlacement:
        """Descend until the predicted reduction, the trust region or plans run out."""
        span, n = high - low, low.size
        best, gradient, solutions = self._tried(np.zeros(n), [None] * len(self.tasks))
        radius, hessian = FIRST_RADIUS, np.zeros((n, n))
        # Updates with negative curvature are skipped; the first update sets the scale.
        model = BFGS(exception_strategy="skip_update", init_scale="auto")
        model.initialize(n, "hess")
        while self.plans + len(self.tasks) <= most_plans and radius > LEAST_RADIUS:
            x, reach = best.values, radius * span
            box = np.maximum(low, x - reach), np.minimum(high, x + reach)
            place, predicted = _step(x, gradient, hessian, *box)
            if predicted <= LEAST_REDUCTION * best.T:
                break
            try:
                trial, slope, found = self._tried(place, solutions)
            except TominpmpError:
                self.trials.append(Trial(frozen_array(place), math.inf, self.plans))
                radius *= SHRINK
                continue
            model.update(place - x, slope - gradient)
            hessian = model.get_matrix()
            if trial.T >= best.T:
                radius *= SHRINK
                continue
            if best.T - trial.T > 0.5 * predicted:
                radius = min(radius * GROW, 1.0)
            best, gradient, solutions = trial, slope, found
        return ImprovedPlacement(
            names=self.moves.names,
            values=best.values,
            placement=self.moves.placement(best.values),
            T=best.T,
            T_before=self.trials[0].T,
            plans=self.plans,
            trials=tuple(self.trials),
            solutions=tuple(solutions),
        )

    def _tried(
        self, x: Array, starts: Sequence[Solution | None]
    ) -> tuple[Trial, Array, list[Solution]]:
        """Plan all tasks at a placement, and note the trial.

        Args:
            x: The coordinates, shape (k,) [m or rad].
            starts: Warm starts of the plans, by task; None for a cold start.

        Returns:
            The trial; the derivative of its T by the coordinates, shape (k,) [s/m or
            s/rad]; and the motions of the tasks.

        Raises:
            TominpmpError: If a task is impossible there, or has no motion, or its
                motion has no sensitivities.
        """
        count, placed = len(self.tasks), self.moves.mover(x)
        problems, solutions, slopes = list[Problem](), list[Solution](), list[Array]()
        for number, task in enumerate(self.tasks):
            with _of_task(number, count):
                problems.append(placed(task))
        for number, (problem, start) in enumerate(zip(problems, starts, strict=True)):
            self.plans += 1
            with _of_task(number, count):
                solution = plan(problem, self.options, start)
                if solution.status is Status.INTERRUPTED:
                    raise KeyboardInterrupt
                if not solution.success:
                    found = f"no motion at the initial placement: {solution.message}"
                    raise ProblemError(found)
                slopes.append(self.moves.gradient(solution.sensitivities, x))
            solutions.append(solution)
        T = float(self.weights @ np.array([item.T for item in solutions]))
        self.trials.append(Trial(frozen_array(x), T, self.plans))
        return self.trials[-1], self.weights @ np.array(slopes), solutions


def _step(
    x: Array, gradient: Array, hessian: Array, low: Array, high: Array
) -> tuple[Array, float]:
    """Minimise the quadratic model of T about a placement, which is convex, in a box.

    Args:
        x: The coordinates, shape (k,) [m or rad].
        gradient: First derivatives of the model there, shape (k,) [s/m or s/rad].
        hessian: Second derivatives of the model, shape (k, k).
        low: Lower ends of the box, shape (k,) [m or rad].
        high: Its upper ends, shape (k,) [m or rad].

    Returns:
        The minimiser, shape (k,) [m or rad], and the predicted reduction of T [s].
    """
    result = minimize(
        lambda d: (gradient @ d + 0.5 * d @ hessian @ d, gradient + hessian @ d),
        np.zeros(x.size),
        jac=True,
        bounds=np.stack([low - x, high - x], axis=1),
        method="L-BFGS-B",
    )
    return np.clip(x + result.x, low, high), -float(result.fun)
