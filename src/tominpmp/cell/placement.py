"""Moves the base of a robot, obstacles or goals to where tasks take less time.

The duration of every task comes with its derivatives by all places, so that a plan of
each task tells which way to go. Steps are those of a quasi-Newton method within bounds;
the plans of a step begin with the motions of the last one.
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
from tominpmp.checks import instance, whole, wrong
from tominpmp.combined_robots import base_placement
from tominpmp.exceptions import ProblemError, TominpmpError, brief, naming
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.robot.robot import Robot
from tominpmp.scene.scene import Scene
from tominpmp.sensitivities.records import Sensitivities
from tominpmp.solution import Solution

TRANSLATIONS, ROTATIONS = ("x", "y", "z"), ("roll", "pitch", "yaw")
COORDINATES = TRANSLATIONS + ROTATIONS
BASE, GOALS = "base", "goals"


def robot_at(robot: Robot, base: Any) -> Robot:
    """The robot with its base somewhere else in the world.

    Args:
        robot: The robot.
        base: Placement base_to_world of the root of its description: anything that
            says a pose, or a position, shape (3,) [m].

    Raises:
        ProblemError: If an argument is of another type.
    """
    instance(robot, Robot, "robot")
    placement = base_placement(robot.name, base, "base")
    return robot._rebuilt(description=robot.description.on_base(placement))


@dataclass(frozen=True, eq=False)
class Moves:
    """How the problems of tasks change with some coordinates.

    Attributes:
        what: "base", "goals", or names of obstacles.
        names: Names of the coordinates that are free.
        robot: The robot.
        base: Placement of its base where all coordinates are zero.
    """

    what: str | tuple[str, ...]
    names: tuple[str, ...]
    robot: Robot
    base: pin.SE3

    def placement(self, x: Array) -> pin.SE3:
        """The displacement, of the base about its own origin; shape (k,) to SE3."""
        twist = self._twist(x)
        if self.what != BASE:
            return pin.SE3(np.eye(3), twist[:3])
        turned = pin.exp3(twist[3:]) @ self.base.rotation
        return pin.SE3(turned, self.base.translation + twist[:3])

    def _twist(self, x: Array) -> Array:
        twist = np.zeros(6)
        twist[[COORDINATES.index(name) for name in self.names]] = x
        return twist

    def mover(self, x: Array) -> Callable[[Problem], Problem]:
        """The function that applies a placement to a task.

        Raises:
            TominpmpError: If a task cannot be: a start that collides, say.
        """
        move = self.placement(x)
        by = np.array(move.translation)
        if self.what == BASE:
            # Tasks share a robot, whose meshes are read once.
            robot = robot_at(self.robot, move)
            return lambda task: replace(task, robot=robot)
        if self.what == GOALS:
            return lambda task: replace(task, goal=task.goal.moved(by))

        def with_obstacles(task: Problem) -> Problem:
            scene = [
                replace(item, position=item.position + by)
                if item.name in self.what
                else item
                for item in task.scene
            ]
            return replace(task, scene=Scene(scene))

        return with_obstacles

    def gradient(self, found: Sensitivities, x: Array) -> Array:
        """Derivative of the duration of a task by the coordinates [s/m or s/rad]."""
        slopes = np.zeros(6)
        if self.what == BASE:
            base, twist = found.base, self._twist(x)
            # Of a rotation about where the base is, not about the world's origin.
            here = self.placement(x).translation
            about = base[3:] - np.cross(here, base[:3])
            slopes[:3] = base[:3]
            slopes[3:] = pin.Jexp3(-twist[3:]).T @ about
        else:
            kind = "goal" if self.what == GOALS else "obstacle"
            for item in found.of(kind):
                own = kind == "goal" or item.subject in self.what
                if own and item.vector is not None:
                    slopes[:3] += item.vector
        chosen = slopes[[COORDINATES.index(name) for name in self.names]]
        return np.asarray(found.T * chosen)


# The first step, as a share of the bounds, and the least one that is tried.
FIRST, LEAST = 0.15, 2e-3
# A step that promises less than this share of the time is not made.
ENOUGH = 5e-4
GROW, SHRINK = 1.7, 0.35


@dataclass(frozen=True, eq=False)
class Trial(Record):
    """A placement that was tried.

    Attributes:
        values: The coordinates, shape (k,) [m or rad].
        T: Sum of the weighted durations of the tasks [s]; infinite if one failed.
        plans: How many plans had been made by then.
    """

    values: Array
    T: float
    plans: int


@dataclass(frozen=True, eq=False)
class ImprovedPlacement(Record):
    """The best placement that was found.

    Attributes:
        names: Names of the coordinates.
        values: Their values: displacements from where it began, shape (k,) [m or rad].
        placement: Placement base_to_world of the base; of obstacles and goals, their
            displacement.
        T: Sum of the weighted durations of the tasks [s].
        T_before: The same where it began.
        plans: How many plans were made.
        trials: All placements that were tried, in that order.
        solutions: The motions of the tasks; their problems have the placement.
    """

    names: tuple[str, ...]
    values: Array
    placement: pin.SE3
    T: float
    T_before: float
    plans: int
    trials: tuple[Trial, ...] = field(repr=False)
    solutions: tuple[Solution, ...] = field(repr=False)

    def __repr__(self) -> str:
        """The placement and the times before and after, on one line."""
        where = ", ".join(
            f"{name} {value:+.4g}"
            for name, value in zip(self.names, self.values.tolist(), strict=True)
        )
        return (
            f"<ImprovedPlacement {where}: T = {self.T:.4f} s, was "
            f"{self.T_before:.4f} s, {self.plans} plans>"
        )


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

    Starts of tasks stay the configurations they are; goals on frames and obstacles stay
    where they are in the world. What is found is the optimum that lies downhill.

    Args:
        robot: The robot.
        tasks: What it has to do: problems, of one segment each, in which ``robot`` is
            put at the base.
        base: Where the base is at the beginning: a placement base_to_world or a
            position, shape (3,) [m]; None for the origin of the world.
        bounds: By the names of the coordinates that may change ("x", "y", "z", and for
            the base "roll", "pitch", "yaw" about its own origin), how far either way
            [m or rad], as (lower, upper) about zero.
        moves: What is moved: "base", "goals" (all of them), or names of obstacles.
        weights: How often each task is done; None for once each.
        most_plans: Number of plans after which no other step is made.
        options: Options of the plans.
        **changes: Options by name, which go before these.

    Returns:
        The best placement found, at worst the one that it began with.

    Raises:
        ProblemError: If an argument is wrong, or a task has no motion where it begins.
        OptionsError: If an option is wrong.
    """
    instance(robot, Robot, "robot")
    given, low, high = _checked(tasks, bounds)
    names = tuple(bounds)
    what = _what(moves, given, names)
    place = base_placement(robot.name, np.zeros(3) if base is None else base, "base")
    scale = np.ones(len(given)) if weights is None else array_or_nan(weights)
    if scale.shape != (len(given),) or not np.all(np.isfinite(scale) & (scale > 0.0)):
        raise wrong(weights, "weights", f"{len(given)} positive numbers, one a task")
    most_plans = whole(most_plans, "most_plans", least=1, expected="a number >= 1")
    options = Options.of(options).changed(changes)
    search = _Search(Moves(what, names, robot, place), given, scale, options)
    return search.run(low, high, most_plans)


def _checked(tasks: Any, bounds: Any) -> tuple[list[Problem], Array, Array]:
    expected = "problems of one segment, one or more"
    if isinstance(tasks, Problem) or not isinstance(tasks, Sequence) or not tasks:
        raise wrong(tasks, "tasks", expected)
    for number, task in enumerate(tasks):
        if not isinstance(task, Problem) or task.segments:
            raise ProblemError(
                f"tasks: number {number + 1} of {len(tasks)} is {brief(task)}, "
                f"expected {expected}",
                f"tasks[{number}]",
            )
    instance(bounds, Mapping, "bounds", "ranges by the names of coordinates")
    rows = []
    for name, pair in bounds.items():
        row = array_or_nan(pair)
        fine = row.shape == (2,) and row[0] <= 0.0 <= row[1] and row[0] < row[1]
        if name not in COORDINATES or not fine or not np.all(np.isfinite(row)):
            raise ProblemError(
                f"bounds: {brief(name)} is {brief(pair)}, expected one of "
                f"{', '.join(COORDINATES)} with a range about zero [m or rad]",
                "bounds",
            )
        rows.append(row)
    if not rows:
        raise ProblemError("bounds is empty, expected a coordinate or more", "bounds")
    table = np.array(rows)
    return list(tasks), table[:, 0], table[:, 1]


def _of_task(number: int, count: int) -> AbstractContextManager[None]:
    """Errors that arise within this are about a task."""
    return naming(f"tasks: number {number + 1} of {count}", f"tasks[{number}]")


def _what(
    moves: Any, tasks: Sequence[Problem], names: Sequence[str]
) -> str | tuple[str, ...]:
    """Check the choice of things to move, and that they can be moved."""
    if isinstance(moves, str) and moves == BASE:
        return BASE
    if not set(names) <= set(TRANSLATIONS):
        raise ProblemError(
            f"bounds has {', '.join(names)}, expected some of "
            f"{', '.join(TRANSLATIONS)}: what is not the base does not turn",
            "bounds",
        )
    if isinstance(moves, str) and moves == GOALS:
        for number, task in enumerate(tasks):
            with _of_task(number, len(tasks)):
                task.goal.moved(np.zeros(3))
        return GOALS
    chosen = (moves,) if isinstance(moves, str) else moves
    known = {item.name: item for task in tasks for item in task.scene}
    resting = [name for name, item in known.items() if item.motion is None]
    given = list(chosen) if isinstance(chosen, Sequence) else []
    if not given or any(name not in resting for name in given):
        there = ", ".join(resting) or "there are none"
        raise wrong(moves, "moves", f"'base', 'goals' or obstacles at rest: {there}")
    return tuple(given)


@dataclass(frozen=True, eq=False)
class _Point:
    """A placement at which all tasks have motions."""

    x: Array
    T: float
    slope: Array
    solutions: tuple[Solution, ...]


@dataclass(eq=False)
class _Search:
    """Quasi-Newton steps within bounds."""

    moves: Moves
    tasks: list[Problem]
    weights: Array
    options: Options
    plans: int = 0
    trials: list[Trial] = field(default_factory=list)

    def run(self, low: Array, high: Array, most_plans: int) -> ImprovedPlacement:
        """Go downhill until nothing is gained."""
        span = high - low
        start = np.zeros(low.size)
        best = self._point(start, self._motions(start, [None] * len(self.tasks)))
        radius, curvature = FIRST, np.zeros((low.size, low.size))
        # Left out where the curvature is not positive; scaled by the first update.
        model = BFGS(exception_strategy="skip_update", init_scale="auto")
        model.initialize(low.size, "hess")
        while self.plans + len(self.tasks) <= most_plans and radius > LEAST:
            reach = radius * span
            box = np.maximum(low, best.x - reach), np.minimum(high, best.x + reach)
            x, promised = _step(best, curvature, *box)
            if promised < ENOUGH * best.T:
                break
            try:
                motions = self._motions(x, best.solutions)
            except TominpmpError:
                self.trials.append(Trial(frozen_array(x), math.inf, self.plans))
                radius *= SHRINK
                continue
            found = self._point(x, motions)
            model.update(found.x - best.x, found.slope - best.slope)
            curvature = model.get_matrix()
            if found.T >= best.T:
                radius *= SHRINK
                continue
            if best.T - found.T > 0.5 * promised:
                radius = min(radius * GROW, 1.0)
            best = found
        return ImprovedPlacement(
            names=self.moves.names,
            values=frozen_array(best.x),
            placement=self.moves.placement(best.x),
            T=best.T,
            T_before=self.trials[0].T,
            plans=self.plans,
            trials=tuple(self.trials),
            solutions=best.solutions,
        )

    def _motions(self, x: Array, starts: Sequence[Solution | None]) -> list[Solution]:
        """Plan all tasks at a placement.

        Args:
            x: The coordinates, shape (k,) [m or rad].
            starts: What the plans begin with, by task; None for nothing.

        Raises:
            TominpmpError: If a task cannot be there, or has no motion there.
        """
        count, move = len(self.tasks), self.moves.mover(x)
        problems, solutions = list[Problem](), list[Solution]()
        for number, task in enumerate(self.tasks):
            with _of_task(number, count):
                problems.append(move(task))
        for number, (problem, start) in enumerate(zip(problems, starts, strict=True)):
            self.plans += 1
            with _of_task(number, count):
                found = plan(problem, self.options, start)
            if not found.success:
                raise ProblemError(
                    f"tasks: number {number + 1} of {count} has no motion where "
                    f"the placement begins: {found.message}",
                    f"tasks[{number}]",
                )
            solutions.append(found)
        return solutions

    def _point(self, x: Array, solutions: list[Solution]) -> _Point:
        """What the motions of all tasks take at a placement, and its slope."""
        T = float(self.weights @ np.array([item.T for item in solutions]))
        slopes = [self.moves.gradient(item.sensitivities, x) for item in solutions]
        self.trials.append(Trial(frozen_array(x), T, self.plans))
        return _Point(x, T, self.weights @ np.array(slopes), tuple(solutions))


def _step(
    point: _Point, curvature: Array, low: Array, high: Array
) -> tuple[Array, float]:
    """Least value of a convex quadratic within a box.

    Returns:
        Where it is, and what it promises.
    """
    slope, here = point.slope, point.x
    found = minimize(
        lambda d: (slope @ d + 0.5 * d @ curvature @ d, slope + curvature @ d),
        np.zeros(here.size),
        jac=True,
        bounds=np.stack([low - here, high - here], axis=1),
        method="L-BFGS-B",
    )
    return np.clip(here + found.x, low, high), -float(found.fun)
