"""Configurations that reach a goal on a frame, by damped least squares."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.constraints.path import PathConstraint
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import nearest_turns
from tominpmp.goals.place import Scales
from tominpmp.initial_guess.path import speed_weights
from tominpmp.initial_guess.rrt import is_free
from tominpmp.least_squares import damped_step, each, least_squares
from tominpmp.transcription.problem_functions import ProblemFunctions

STEPS = 60
# Longest step of a joint [rad, or shares of the length that counts as 1 rad].
LONGEST_STEP = 0.5
# Residuals that end the steps, and that count as zero [m, rad]; of arms shorter than a
# metre shares of their length.
TOLERANCE, REACHED = 1e-8, 1e-6
# Two solutions closer than the first distance count as one; solutions within the second
# of a former solution come last [rad, or shares of the length that counts as 1 rad].
DISTINCT, SPREAD = 1e-2, 0.5
# Starts are drawn from a box of this half width around the start of the motion [rad, or
# shares of the length that counts as 1 rad].
AROUND = np.pi
# Largest number of configurations in collision that are led out of it.
LED_OUT = 10
# Starts are drawn from the whole of that box, and as often from this share of it around
# the start of the motion: they mostly lead to the solutions that are reached soonest.
# For 12 of 60 goals no solution came within 3 % of the nearest configuration without
# these starts, for 2 with them.
NEARER = 0.4
# Singular values of a goal's Jacobian below this share of the largest count as zero.
RANK = 1e-6
# Steps that lead solutions nearer to the start: their number, the longest step, and the
# step that ends them [rad].
STEPS_NEARER, STEP_NEARER, SHORTEST_STEP = 25, 0.2, 1e-3
# The largest displacement counts: the sum of fourth powers stands for it. Displacements
# below this share of the largest one are weighted as if they were that large.
POWER, LEAST_SHARE = 4, 0.05
# Distance beyond the required clearance to which bodies are led apart [m].
BEYOND = 1e-3


class AtGoal:
    """Conditions on the configuration in which a segment ends.

    Attributes:
        scales: Amounts that count as 1 rad, of joints and of errors.

    Args:
        system: Kinematics and limits.
        goal: The goal.
        alone: Whether the goal is the only condition, without constraints.
        beyond: Constraints on positions that hold from there on.
        apart: Whether bodies are to keep their distances, too.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        goal: Goal,
        *,
        alone: bool = False,
        beyond: Sequence[PathConstraint] = (),
        apart: bool = False,
    ) -> None:
        self.system, self.goal = system, goal
        place = goal.place(system.kinematics, system.problem.q_start)
        self.scales = Scales.of(system.kinematics, place)
        self.clearance = system.clearance if apart else None
        rests = goal.fixes_velocity and not np.any(goal.final_velocity(system.n))
        self.constraints = tuple(
            item
            for item in (*system.problem.ready_constraints, *beyond)
            if not alone
            and (item.order == 0 or rests)
            and (item.window is None or np.isinf(item.window.end))
        )

    def residual(self, q: Array) -> tuple[Array, Array]:
        """Residual of all conditions at a configuration, and its Jacobian.

        Returns:
            Shapes (k,) and (k, n), with lengths of the goal in units of their scale;
            zero where the conditions are met.
        """
        place = self.goal.place(self.system.kinematics, q)
        value, by_q = place.residual()
        share = np.where(place.lengths, 1.0 / self.scales.lengths, 1.0)
        every = [(share * value, share[:, None] * by_q)]
        every += [item.excess_at_rest(q) for item in self.constraints]
        if self.clearance is not None:
            every.append(self._overlap(self.clearance, q))
        values, slopes = zip(*every, strict=True)
        return np.concatenate(values), np.concatenate(slopes)

    def missing(self, q: Array) -> float:
        """Norm of the violation of all conditions at a configuration [m, rad]."""
        value, _ = self.residual(q)
        place = self.goal.place(self.system.kinematics, q)
        value[: place.value.size] = place.excess
        return float(np.linalg.norm(value))

    def _overlap(self, clearance: ClearanceConstraint, q: Array) -> tuple[Array, Array]:
        """Missing clearances of the collision pairs that are too close [m]."""
        lack = clearance.length * clearance.values(q[None])[0] + BEYOND
        near = np.flatnonzero(lack > 0.0)
        first = np.zeros(near.size, dtype=np.int64)
        found = clearance.derivatives_at(q[None], first, near)
        return lack[near], clearance.length * found.gradients


class GoalSearch(NamedTuple):
    """Configurations that reach a goal.

    Attributes:
        free: Configurations clear of obstacles, the most promising first, each of
            shape (n,).
        blocked: Configurations in collision.
        least: Smallest residual seen if no configuration reached the goal (else 0).
    """

    free: list[Array]
    blocked: list[Array]
    least: float

    @property
    def best(self) -> list[Array]:
        """The free configurations; those in collision if there are no free ones."""
        return self.free or self.blocked


def solve_inverse_kinematics(
    system: ProblemFunctions,
    goal: Goal,
    q: Array,
    *,
    apart: bool = False,
) -> tuple[Array, float]:
    """Bring the placement residual of a goal to zero within the position limits.

    Constraints that hold at all times of a problem hold there, too.

    Args:
        system: Kinematics and limits.
        goal: The goal.
        q: Configuration to start from, shape (n,) [rad or m].
        apart: Whether bodies are to keep their distances, too.

    Returns:
        Configuration, shape (n,), and the norm of the residual left there.
    """
    asked = AtGoal(system, goal, apart=apart)
    (q,), _ = _solved(asked, q[None])
    return q, asked.missing(q)


def _solved(asked: AtGoal, q: Array) -> tuple[Array, Array]:
    """Configurations led to the goal, shape (m, n), and norms of their residuals."""
    limits = asked.system.problem.robot.limits
    return least_squares(
        each(lambda _, q: asked.residual(q)),
        q,
        (limits.position_lower, limits.position_upper),
        asked.scales.joints,
        LONGEST_STEP * asked.scales.joints,
        reached=TOLERANCE,
        steps=STEPS,
    )


def find_configurations(
    system: ProblemFunctions,
    goal: Goal,
    count: int,
    rng: np.random.Generator,
    *,
    alone: bool = False,
    beyond: Sequence[PathConstraint] = (),
) -> GoalSearch:
    """Distinct configurations that reach a goal, from twice ``count`` starts.

    Configurations that the speed limits let the arm reach soonest come first, unless
    they are near to a former one. If all are in collision, and the goal leaves the arm
    any freedom, a way out of collision is searched for.

    Returns:
        Configurations clear of obstacles and those in collision.
    """
    problem = system.problem
    limits = problem.robot.limits
    asked = AtGoal(system, goal, alone=alone, beyond=beyond)
    around = AROUND * asked.scales.joints
    low = np.maximum(limits.position_lower, problem.q_start - around)
    high = np.minimum(limits.position_upper, problem.q_start + around)
    wide = [rng.uniform(low, high) for _ in range(count)]
    near = [problem.q_start + NEARER * (q - problem.q_start) for q in wide]
    found, nearest = _led(asked, [problem.q_start, *wide, *near])
    if not alone:
        movable = [q for q in found if not isolated(asked, q)]
        found += _led(asked, led_nearer(asked, movable), found)[0]
    ways = nearest_turns(problem.robot, found, problem.q_start)
    if len(ways) > len(found):
        # A mimic joint or a constraint may tell turns apart.
        found = [q for q in ways if asked.missing(q) < REACHED] or found
    weights = speed_weights(limits.velocity)
    found.sort(key=lambda q: float(np.max(np.abs(q - problem.q_start) * weights)))
    clear: list[Array] = []
    others: list[Array] = []
    for q in found:
        (clear if is_free(system, q) else others).append(q)
    free, blocked = _spread(asked, clear), _spread(asked, others)
    if not free and system.clearance is not None:
        apart = AtGoal(system, goal, alone=alone, beyond=beyond, apart=True)
        movable = [q for q in blocked[:LED_OUT] if not isolated(asked, q)]
        free = [q for q in _led(apart, movable)[0] if is_free(system, q)]
    return GoalSearch(free, blocked, 0.0 if found else asked.missing(nearest))


def _led(
    asked: AtGoal, starts: Sequence[Array], known: Sequence[Array] = ()
) -> tuple[list[Array], Array]:
    """Configurations that reach the goal from given starts, and the nearest one.

    Configurations near to a known or a former one are left out. The nearest one has the
    smallest residual.
    """
    found = list[Array]()
    if not starts:
        return found, asked.system.problem.q_start
    ends, errors = _solved(asked, np.stack(starts))
    for q, error in zip(ends, errors, strict=True):
        if error < REACHED and not _near(asked, q, [*known, *found], DISTINCT):
            found.append(q)
    return found, np.asarray(ends[np.argmin(errors)])


def led_nearer(asked: AtGoal, found: Sequence[Array]) -> list[Array]:
    """Lead configurations along the self-motion to where the slowest joint moves least.

    Damped least squares end anywhere on the self-motion manifold of a goal, which has
    as many dimensions as the goal leaves joints free. The fastest motion mostly ends
    near the point of the manifold that speed limits let the arm reach soonest, within
    the branch.

    The method takes Newton steps for the sum of the powers, with the goal linearised.

    Args:
        asked: Conditions on the configurations.
        found: Configurations that reach the goal, each of shape (n,) [rad or m].

    Returns:
        As many configurations, near to some that reach the goal.
    """
    problem = asked.system.problem
    limits, start = problem.robot.limits, problem.q_start
    low, high = limits.position_lower, limits.position_upper
    weights, scale = speed_weights(limits.velocity), asked.scales.joints
    out, rows = np.array(found), np.arange(len(found))
    residual = each(lambda _, q: asked.residual(q))
    for _ in range(STEPS_NEARER):
        if not rows.size:
            break
        q = out[rows]
        value, slope = residual(q, rows)
        share = weights * np.abs(q - start)
        largest = np.maximum(share.max(axis=1, keepdims=True), 1e-12)
        share = np.maximum(share / largest, LEAST_SHARE)
        unit = 1.0 / (weights * share ** (POWER / 2 - 1))
        # If the objective were a weighted square, the full way would be the step.
        way = (q - start) / (POWER - 1)
        step = _step(value, slope, unit, way)
        pinned = ((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0))
        if np.any(pinned):
            step = _step(value, slope, unit * ~pinned, way * ~pinned)
        far = np.max(np.abs(step) / scale, axis=1)
        step *= np.minimum(1.0, STEP_NEARER / np.maximum(far, 1e-12))[:, None]
        out[rows] = np.clip(q + step, low, high)
        rows = rows[far >= SHORTEST_STEP]
    return list(out)


def _step(value: Array, slope: Array, unit: Array, way: Array) -> Array:
    """Steps that undo most of a displacement, with zero linearised residual.

    Args:
        value: The residual, shape (m, k).
        slope: Its derivatives, shape (m, k, n).
        unit: Displacements of equal weight, shape (m, n); zero for joints that stay.
        way: Displacement that the steps are to undo as far as they can, shape (m, n).
    """
    left = value - (slope @ way[:, :, None])[:, :, 0]
    return damped_step(left, slope, unit, np.zeros(len(value))) - way


def isolated(asked: AtGoal, q: Array) -> bool:
    """Whether a configuration is the only one around that reaches the goal."""
    _, by_q = asked.goal.place_residual(asked.system.kinematics, q)
    values = np.linalg.svd(by_q * asked.scales.joints, compute_uv=False)
    return values.size == q.size and bool(values[-1] > RANK * values[0])


def shut_out(system: ProblemFunctions, blocked: Sequence[Array]) -> bool:
    """Whether the goal can be reached in collision only.

    It can where each configuration is the only one around, and its bodies violate the
    margins themselves, not only the padding beyond them.
    """
    problem = system.problem
    if not blocked or problem.checker.moving:
        return False
    margins = problem.checker.margins(problem.margin)
    asked = AtGoal(system, problem.goal)
    return all(
        isolated(asked, q) and not problem.checker.is_free(q, margins) for q in blocked
    )


def _near(asked: AtGoal, q: Array, others: list[Array], distance: float) -> bool:
    apart = (np.abs(q - other) / asked.scales.joints for other in others)
    return any(float(one.max()) <= distance for one in apart)


def _spread(asked: AtGoal, found: list[Array]) -> list[Array]:
    """Put configurations that are near to a former one last."""
    first: list[Array] = []
    last: list[Array] = []
    for q in found:
        (last if _near(asked, q, first, SPREAD) else first).append(q)
    return first + last
