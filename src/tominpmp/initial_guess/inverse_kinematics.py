"""Configurations and velocities that reach a goal, by damped least squares."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, IntArray
from tominpmp.collision.query import ROUNDING
from tominpmp.constraints.clearance import ClearanceConstraint
from tominpmp.constraints.path import PathConstraint
from tominpmp.goals.base import Goal
from tominpmp.goals.joints import nearest_turns
from tominpmp.goals.place import Scales
from tominpmp.goals.turns import TURN
from tominpmp.initial_guess.path import speed_weights
from tominpmp.initial_guess.rrt import is_free
from tominpmp.kinematics import units_of
from tominpmp.least_squares import LONGEST_STEP, damped_step, least_squares, padded
from tominpmp.problem.state_checks import unheld
from tominpmp.stopping import check
from tominpmp.transcription.problem_functions import ProblemFunctions

# Residual that ends the least-squares steps, and residual up to which the goal counts
# as reached [m, rad]; for arms shorter than a metre, shares of their length.
TOLERANCE, REACHED = 1e-8, 1e-6
# Two solutions closer than DISTINCT count as one; solutions within SPREAD of a former
# solution come last [rad, or shares of the length that counts as 1 rad].
DISTINCT, SPREAD = 1e-2, 0.5
# Starts are drawn from a box of this half width around the start of the motion, shifted
# into the position limits [rad, or shares of the length that counts as 1 rad].
AROUND = np.pi
# Most configurations that are moved out of collision, and most that are approached on a
# timed straight line.
MOST_TRIED = 10
# Half of the starts are drawn from the whole box, the others from this share of it
# around the start of the motion, as these mostly lead to the solutions that are reached
# soonest. Without them no solution was within 3 % of the nearest configuration for 12
# of 60 goals, with them for 2.
NEARER = 0.4
# Singular values of the Jacobian of a goal below this share of the largest count as 0.
RANK = 1e-6
# Steps that move solutions nearer to the start: most steps, the longest step, and the
# step length below which they end [rad].
STEPS_NEARER, STEP_NEARER, SHORTEST_STEP = 25, 0.2, 1e-3
# The largest displacement of a joint is approximated by the sum of fourth powers.
# Displacements below LEAST_SHARE of the largest one are weighted as if they had it.
POWER, LEAST_SHARE = 4, 0.05
# Additional clearance with which configurations are moved out of collision [m].
EXTRA_CLEARANCE = 1e-3


@dataclass(frozen=True, eq=False)
class GoalVelocity:
    """The condition that the joints give a frame its velocity within their limits.

    Attributes:
        system: Kinematics and limits.
        goal: The goal, with a velocity of its frame.
        name: Name of the condition, in messages.
    """

    system: ProblemFunctions
    goal: Goal
    name: str = "velocity of the goal"

    def nearest(self, q: Array) -> tuple[Array, Array]:
        """Joint velocities within their limits that miss the goal's velocity least.

        Returns:
            Joint velocities at configurations, near to those at the start, shape (m,
            n), and the velocities that they lack, shape (m, 3) [m/s].
        """
        top = self.system.problem.robot.limits.velocity
        value, slope = padded(self._residual(row, 0.0 * row)[::2] for row in q)

        def missing(v: Array, rows: IntArray) -> tuple[Array, Array]:
            return value[rows] + (slope[rows] @ v[:, :, None])[:, :, 0], slope[rows]

        v = np.tile(self.system.problem.v_start, (len(q), 1))
        ends, scale = (-top, top), 1.0 / speed_weights(top)
        v, _ = least_squares(missing, v, ends, scale, 2.0 * scale, reached=TOLERANCE)
        return v, missing(v, np.arange(len(q)))[0]

    def excess_at_rest(self, q: Array) -> tuple[Array, Array]:
        """Missing speeds at configurations, shape (m, 1) [m/s], and Jacobians."""
        v, missing = self.nearest(q)
        lack = np.linalg.norm(missing, axis=1, keepdims=True)
        lack[lack < TOLERANCE] = 0.0
        along = np.sign(lack) * missing / np.maximum(lack, TOLERANCE)
        # A change of the nearest velocities does not change the distance to them.
        slopes = [self._residual(*state)[1] for state in zip(q, v, strict=True)]
        return lack, along[:, None] @ np.array(slopes)

    def lack(self, q: Array, v: Array, slack: float) -> str:
        """The missing speed at a configuration, as a clause."""
        robot, ((v,), (missing,)) = self.system.problem.robot, self.nearest(q[None])
        said = [f"the {self.name} is {np.linalg.norm(missing):.4g} m/s off"]
        for i in np.flatnonzero(np.abs(v) >= robot.limits.velocity).tolist()[:1]:
            top = f"its limit of {abs(v[i]):.4g} {units_of(robot)[i]}/s"
            said.append(f"with joint {robot.joint_names[i]!r} at {top}")
        return " ".join(said)

    def _residual(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        return self.goal.motion_residual(self.system.kinematics, q, v)


def end_velocity(system: ProblemFunctions, q_end: Array) -> Array:
    """Velocity at the end that meets the goal, nearest to that at the start, (n,).

    Args:
        system: Functions of the problem.
        q_end: Final configuration, shape (n,).
    """
    goal, fixed = system.problem.goal, system.final_velocity
    if fixed is None and goal.speed_count(system.n):
        return np.asarray(GoalVelocity(system, goal).nearest(q_end[None])[0][0])
    return system.problem.v_start if fixed is None else fixed


@dataclass(frozen=True, eq=False)
class Target:
    """Conditions on the final configuration of a segment: goal and constraints.

    Attributes:
        system: Kinematics and limits.
        goal: The goal.
        goal_only: Whether constraints are left out.
        beyond: Constraints on positions that hold from the goal on.
        keep_clear: Whether clearances between bodies are conditions, too.
    """

    system: ProblemFunctions
    goal: Goal
    _: KW_ONLY
    goal_only: bool = False
    beyond: Sequence[PathConstraint] = ()
    keep_clear: bool = False

    @cached_property
    def scales(self) -> Scales:
        """Amounts that count as 1 rad, of joints and of residuals."""
        kinematics, start = self.system.kinematics, self.system.problem.q_start
        return Scales.of(kinematics, self.goal.place(kinematics, start))

    @cached_property
    def rests(self) -> bool:
        """Whether the arm comes to rest at the goal."""
        return self.goal.fixes_velocity and not self.goal.ends_moving

    @cached_property
    def constraints(self) -> tuple[PathConstraint | GoalVelocity, ...]:
        """The constraints that hold at the final configuration."""
        goal, system = self.goal, self.system
        if self.goal_only:
            return ()
        held = tuple(
            item
            for item in (*system.problem.ready_constraints, *self.beyond)
            if (item.order == 0 or self.rests)
            and (item.window is None or np.isinf(item.window.end))
        )
        if not goal.fixes_velocity and goal.speed_count(system.n):
            return (GoalVelocity(system, goal), *held)
        return held

    def residual(self, q: Array) -> tuple[Array, Array]:
        """Residuals of all conditions at configurations, and their Jacobians.

        Args:
            q: Configurations, shape (m, n) [rad or m].

        Returns:
            Shapes (m, k) and (m, k, n), with lengths of the goal in units of their
            scale; zero for conditions that are met.
        """
        terms = [padded(self._to_goal(row) for row in q)]
        terms += [item.excess_at_rest(q) for item in self.constraints]
        if self.keep_clear and self.system.clearance is not None:
            terms.append(self._overlap(self.system.clearance, q))
        values, slopes = zip(*terms, strict=True)
        return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)

    def _to_goal(self, q: Array) -> tuple[Array, Array]:
        """Residual of the goal at a configuration, shape (n,), and its Jacobian."""
        place = self.goal.place(self.system.kinematics, q)
        value, by_q = place.residual()
        share = np.where(place.lengths, 1.0 / self.scales.lengths, 1.0)
        return share * value, share[:, None] * by_q

    def violation(self, q: Array) -> float:
        """Norm of the violation of all conditions at a configuration [m, rad]."""
        ((value,), _) = self.residual(q[None])
        place = self.goal.place(self.system.kinematics, q)
        value[: place.value.size] = place.excess
        return float(np.linalg.norm(value))

    def miss(self, q: Array) -> str:
        """How far a configuration misses the goal: "0.2 m and 0.1 rad"."""
        place = self.goal.place(self.system.kinematics, q)
        parts = (place.lengths, "m"), (~place.lengths, "rad")
        sizes = [(np.linalg.norm(place.excess[at]), unit) for at, unit in parts]
        shown = " and ".join(f"{x:.4g} {unit}" for x, unit in sizes if x > REACHED)
        return shown or f"{self.violation(q):.2g} of its conditions"

    def solve(self, q: Array) -> tuple[Array, float]:
        """Find a configuration within the position limits that meets all conditions.

        Args:
            q: Initial configuration, shape (n,) [rad or m].

        Returns:
            Configuration, shape (n,), and the remaining violation [m, rad].
        """
        (q,), _ = _descend(self, q[None])
        return q, self.violation(q)

    def _overlap(self, clearance: ClearanceConstraint, q: Array) -> tuple[Array, Array]:
        """Missing clearances of collision pairs that are too close [m]; Jacobians."""
        lack = clearance.length * clearance.values(q) + EXTRA_CLEARANCE
        at, near = np.nonzero(lack > 0.0)
        slopes = clearance.length * clearance.derivatives_at(q, at, near).gradients
        every = np.searchsorted(at, np.arange(1, len(q)))
        parts = np.split(lack[at, near], every), np.split(slopes, every)
        return padded(zip(*parts, strict=True))

    def configurations(self, count: int, rng: np.random.Generator) -> GoalSearch:
        """Distinct configurations that reach a goal, from twice ``count`` starts.

        The configurations that the arm can reach soonest at its speed limits come
        first, unless they are close to a former one. If all of them are in collision,
        they are moved out of collision as far as the goal leaves the arm any freedom.

        Returns:
            The configurations, and the nearest one found, which may miss the goal.
        """
        system, problem = self.system, self.system.problem
        limits = problem.robot.limits
        # A joint that moves at the start may reach the goal several turns away.
        turns = np.round((self.goal.positions(problem.robot) - problem.q_start) / TURN)
        lower, upper = limits.position_lower, limits.position_upper
        centre = np.clip(problem.q_start + TURN * np.nan_to_num(turns), lower, upper)
        around = AROUND * self.scales.joints
        # Next to a limit the box is shifted, to hold all angles that a joint can reach.
        middle = np.clip(centre, lower + around, upper - around)
        low = np.maximum(lower, middle - around)
        high = np.minimum(upper, middle + around)
        wide = [rng.uniform(low, high) for _ in range(count)]
        near = [centre + NEARER * (q - centre) for q in wide]
        solutions, nearest = _solutions(self, [centre, *wide, *near])
        if not self.goal_only:
            movable = [q for q in solutions if not isolated(self, q)]
            solutions += _solutions(self, moved_nearer(self, movable), solutions)[0]
        turned = nearest_turns(problem.robot, solutions, problem.q_start)
        if len(turned) > len(solutions):
            # With a mimic joint or a constraint, full turns of a joint may differ.
            solutions = [q for q in turned if self.violation(q) < REACHED] or solutions
        weights = speed_weights(limits.velocity)
        solutions.sort(
            key=lambda q: float(np.max(np.abs(q - problem.q_start) * weights))
        )
        clear = np.array([is_free(system, q) for q in solutions], dtype=bool)
        free = _spread(self, compress(solutions, clear))
        blocked = _spread(self, compress(solutions, ~clear))
        if not free and system.clearance is not None:
            movable = [q for q in blocked[:MOST_TRIED] if not isolated(self, q)]
            both = replace(self, keep_clear=True)
            free = [q for q in _solutions(both, movable)[0] if is_free(system, q)]
            # A goal may be closer to an obstacle than the padding beyond the margin.
            free = free or [q for q in blocked if _keeps_margins(system, q)]
        return GoalSearch(free, blocked, nearest)

    def all_unusable(self, found: Sequence[Array], *, passes: bool) -> bool:
        """Whether the arm reaches the goal only in collision, or where it cannot rest.

        This holds if no self-motion is possible at any of the configurations, and all
        of them violate the margins themselves, not only the padding beyond these, or
        need torques beyond the limits at rest.

        Args:
            found: Configurations that reach the goal, each of shape (n,).
            passes: Whether the arm may pass the goal.
        """
        system, problem = self.system, self.system.problem

        def usable(q: Array) -> bool:
            held = passes or not self.rests or not unheld(problem.robot, q)
            return held and (problem.checker.moving or _keeps_margins(system, q))

        return bool(found) and all(isolated(self, q) and not usable(q) for q in found)


class GoalSearch(NamedTuple):
    """Configurations that reach a goal.

    Attributes:
        free: Collision-free configurations, the most promising first, each of shape
            (n,).
        blocked: Configurations in collision.
        nearest: The configuration found that violates the conditions least, shape (n,).
    """

    free: list[Array]
    blocked: list[Array]
    nearest: Array

    @property
    def best(self) -> list[Array]:
        """The free configurations; without any, the configurations in collision."""
        return self.free or self.blocked


def _descend(target: Target, q: Array) -> tuple[Array, Array]:
    """Configurations after least squares, shape (m, n), and norms of residuals."""
    limits = target.system.problem.robot.limits
    return least_squares(
        lambda q, _: target.residual(q),
        q,
        (limits.position_lower, limits.position_upper),
        target.scales.joints,
        LONGEST_STEP * target.scales.joints,
        reached=TOLERANCE,
    )


def _solutions(
    target: Target, starts: Sequence[Array], known: Sequence[Array] = ()
) -> tuple[list[Array], Array]:
    """Configurations that reach the goal from given starts, and the best one.

    Configurations close to a known or a former one are left out. The best one has the
    smallest residual.
    """
    solutions = list[Array]()
    if not starts:
        return solutions, target.system.problem.q_start
    ends, errors = _descend(target, np.stack(starts))
    for q, error in zip(ends, errors, strict=True):
        if error < REACHED and not _near(target, q, [*known, *solutions], DISTINCT):
            solutions.append(q)
    return solutions, np.asarray(ends[np.argmin(errors)])


def moved_nearer(target: Target, solutions: Sequence[Array]) -> list[Array]:
    """Move configurations by self-motion to where they are reached soonest.

    Damped least squares end anywhere on the self-motion manifold of a goal, whose
    dimension is the number of degrees of freedom that the goal leaves. The fastest
    motion mostly ends near the point of its branch that the arm reaches soonest at its
    speed limits, which minimises the largest displacement in time.

    The method takes Newton steps for a sum of powers, with the goal linearised.

    Args:
        target: Conditions on the configurations.
        solutions: Configurations that reach the goal, each of shape (n,) [rad or m].

    Returns:
        The moved configurations, in the same order; they reach the goal only nearly.
    """
    problem = target.system.problem
    limits, start = problem.robot.limits, problem.q_start
    low, high = limits.position_lower, limits.position_upper
    weights, scale = speed_weights(limits.velocity), target.scales.joints
    out, rows = np.array(solutions), np.arange(len(solutions))
    for _ in range(STEPS_NEARER):
        check()
        if not rows.size:
            break
        q = out[rows]
        value, slope = target.residual(q)
        share = weights * np.abs(q - start)
        largest = np.maximum(share.max(axis=1, keepdims=True), 1e-12)
        share = np.maximum(share / largest, LEAST_SHARE)
        unit = 1.0 / (weights * share ** (POWER / 2 - 1))
        # The Newton step for a sum of powers is this share of the displacement.
        excess = (q - start) / (POWER - 1)
        step = _step(value, slope, unit, excess)
        pinned = ((q <= low) & (step < 0.0)) | ((q >= high) & (step > 0.0))
        if np.any(pinned):
            step = _step(value, slope, unit * ~pinned, excess * ~pinned)
        far = np.max(np.abs(step) / scale, axis=1)
        step *= np.minimum(1.0, STEP_NEARER / np.maximum(far, 1e-12))[:, None]
        out[rows] = np.clip(q + step, low, high)
        rows = rows[far >= SHORTEST_STEP]
    return list(out)


def _step(value: Array, slope: Array, unit: Array, excess: Array) -> Array:
    """Steps that undo a displacement as far as possible, with zero linear residual.

    Args:
        value: The residual, shape (m, k).
        slope: Derivatives of the residual, shape (m, k, n).
        unit: Displacements of equal weight, shape (m, n); zero for fixed joints.
        excess: The displacement, shape (m, n).
    """
    residual = value - (slope @ excess[:, :, None])[:, :, 0]
    return damped_step(residual, slope, unit, np.zeros(len(value))) - excess


def isolated(target: Target, q: Array) -> bool:
    """Whether no self-motion is possible at a configuration that reaches the goal."""
    _, by_q = target.goal.place_residual(target.system.kinematics, q)
    values = np.linalg.svd(by_q * target.scales.joints, compute_uv=False)
    return values.size == q.size and bool(values[-1] > RANK * values[0])


def _keeps_margins(system: ProblemFunctions, q: Array) -> bool:
    """Whether a configuration, shape (n,), keeps the margins, except for rounding."""
    problem = system.problem
    margins = problem.checker.margins(problem.margin - ROUNDING)
    # By distances: a query for collisions knows no margins below zero for triangles.
    contact = problem.checker.closest(q, margins)
    return contact is None or contact.distance > contact.margin


def _near(target: Target, q: Array, others: list[Array], distance: float) -> bool:
    apart = (np.abs(q - other) / target.scales.joints for other in others)
    return any(float(difference.max()) <= distance for difference in apart)


def _spread(target: Target, solutions: Iterable[Array]) -> list[Array]:
    """Move configurations that are close to a former one to the end."""
    first, last = list[Array](), list[Array]()
    for q in solutions:
        (last if _near(target, q, first, SPREAD) else first).append(q)
    return first + last
