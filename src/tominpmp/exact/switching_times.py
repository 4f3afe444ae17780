"""Optimal switching times: arcs of exact length in place of intervals of a grid.

A structure of arcs is detected in a motion. Its lengths are optimised by sequential
quadratic programming (Kraft, 1988); arcs of zero length are dropped, and arcs are
inserted where the conditions of Pontryagin's minimum principle are violated, until the
structure does not change. Integration steps are halved until the duration converges, so
that the optimisation does not exploit integration errors.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tominpmp.arrays import Array, IntArray
from tominpmp.exact.shooting import ArcProgram, Shot
from tominpmp.exact.structure import Arcs
from tominpmp.exact.switching_functions import find_changes
from tominpmp.solvers.iterate import Iterate
from tominpmp.stopping import Budget
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

StateFunction = Callable[[Array], Array]

# Number of integration steps over the whole motion while arcs are searched for, and
# numbers for the final accuracy, one after another until the duration changes by less
# than the share ACCURACY.
FEWER_STEPS = 30
STEPS = (60, 120, 240, 480, 960)
ACCURACY = 1e-7
# With more steps than this, the structure is not changed any more.
CHANGED_STEPS = 240
# Least number of steps of an arc.
STEPS_OF_ARC = 2
# Tolerated residuals of equations (goal and held speeds), and tolerated violation of
# limits, in scaled units.
EXACT = 1e-7
SLACK = 1e-6
# Largest number of iterations of SLSQP.
ITERATIONS = 150
# Singular values of the Jacobian of the equations below this share of the largest one
# count as zero: equations are dependent.
DEPENDENT = 1e-10
# Largest number of rounds of dropping arcs of zero length.
CLEANINGS = 4
# Largest number of rounds of adding rows for limits that become active.
LIMIT_ROUNDS = 4
# Largest number of rounds of changes of the structure. A change needs a predicted gain
# of the share PROMISE of the duration, and rounds continue after a gain of PROGRESS.
CHANGES = 25
PROMISE = 1e-7
PROGRESS = 1e-8
# Largest length of an arc, in units of the initial duration of the whole motion.
LONGEST = 3.0
# Relative progress and violation that count as zero.
NEGLIGIBLE = 1e-10
# Stop rules: number of steps, and the relative progress in these steps below which the
# iteration stops. The second rule holds while arcs are searched for.
STOPS = ((2, NEGLIGIBLE), (5, 1e-6))
# The iteration also stops if the violation has not fallen to the share FALL in SLOW
# iterations: arcs of zero length can make it this slow, and are dropped next.
SLOW, FALL = 25, 0.1


@dataclass(frozen=True, eq=False)
class OptimisedArcs:
    """Arcs whose lengths are optimal for their structure.

    Attributes:
        program: The program.
        y: Unknowns at the solution.
        shot: The motion, with its rows.
        excess: Largest violation of limits, on all steps.
    """

    program: ArcProgram
    y: Array
    shot: Shot
    excess: float

    @property
    def arcs(self) -> Arcs:
        """The arcs."""
        return self.program.unpack(self.y)

    @property
    def duration(self) -> float:
        """Duration T [s]."""
        return self.arcs.duration

    @cached_property
    def iterate(self) -> Iterate:
        """The arcs as an iterate of their program."""
        return Iterate.of(self.program, self.y, 1.0)

    @property
    def feasible(self) -> bool:
        """Whether goal and limits are kept within their tolerances."""
        return _violation(self.shot) <= EXACT and self.excess <= SLACK

    def states(self, times: Array) -> Array:
        """States (q, v) at times, linearly interpolated as a guess, shape (m, 2n)."""
        arcs, motion = self.arcs, self.shot.motion
        t = np.concatenate([[0.0], self.program.sample_times(arcs).ravel()])
        x = np.vstack([motion.x_start, motion.stages.reshape(t.size - 1, -1)])
        return np.stack([np.interp(times, t, column) for column in x.T], axis=1)


def steps_of(arcs: Arcs, total: int) -> IntArray:
    """Number of steps of each arc, for a total number over the whole motion."""
    share = arcs.lengths / arcs.duration
    return np.maximum(np.ceil(total * share), STEPS_OF_ARC).astype(np.int64)


def solve_lengths(
    system: ProblemFunctions,
    arcs: Arcs,
    states: StateFunction,
    budget: Budget,
    total: int = STEPS[0],
) -> OptimisedArcs | None:
    """Optimise the lengths and free torques of arcs with a fixed structure.

    Args:
        system: The functions of the problem.
        arcs: The arcs, with approximate lengths.
        states: States (q, v) of a similar motion as a function of times, shape (m,) to
            (m, 2n), the initial guess.
        budget: Budget of evaluations and time.
        total: Number of integration steps over the whole motion.

    Returns:
        The optimised arcs; None if integration fails, or the budget is spent.
    """
    program = ArcProgram(system, arcs, steps_of(arcs, total))
    times = program.sample_times(arcs)
    y = program.pack()
    program.guess = states(times.ravel()).reshape(*times.shape, -1)
    shot = program.shoot(y)
    for _ in range(LIMIT_ROUNDS):
        if shot is None or budget.spent:
            return None
        program.watch(program.nearby(shot.motion))
        y = _minimize(program, y, budget, rough=total <= FEWER_STEPS)
        shot = program.shoot(y)
        excess = np.inf if shot is None else program.excess(shot.motion, 0.1 * SLACK)
        if excess <= SLACK:
            break
    return None if shot is None else OptimisedArcs(program, y, shot, excess)


def _violation(shot: Shot) -> float:
    """Largest residual of equations, or scaled violation of limits beyond the slack."""
    return max(
        float(np.max(np.abs(shot.rows.value[: shot.equations]), initial=0.0)),
        float(np.max(-shot.margin, initial=0.0)) - SLACK,
    )


def _constraints(program: ArcProgram, first: Shot) -> list[dict[str, Any]]:
    """Equations and limits of a program, in the format of SLSQP."""
    count = first.equations
    basis = _independent(first.slopes[:count])

    # Where integration fails, the rows are far beyond their bounds, without a slope.
    def slopes(z: Array) -> Array:
        shot = program.shoot(z)
        return np.zeros_like(first.slopes) if shot is None else shot.slopes

    equations = {
        "type": "eq",
        "fun": lambda z: basis @ program.evaluate(z)[:count],
        "jac": lambda z: basis @ slopes(z)[:count],
    }
    limits = {
        "type": "ineq",
        "fun": lambda z: program.evaluate(z)[count:],
        "jac": lambda z: slopes(z)[count:],
    }
    return [equations, limits] if first.margin.size else [equations]


def _minimize(program: ArcProgram, y: Array, budget: Budget, *, rough: bool) -> Array:
    """Unknowns of least duration, with the watched limits as rows.

    Near the optimum the steps of SLSQP may lead away from the equations again: of the
    iterates that satisfy them the shortest is returned, without any the last one.

    Args:
        program: The program.
        y: Initial unknowns.
        budget: Budget of evaluations and time.
        rough: Whether to stop when progress becomes slow.
    """
    cost = program.of_lengths
    first = program.shoot(y)
    assert first is not None  # noqa: S101
    low, high = cost - 1.0, np.where(cost > 0.0, LONGEST, 1.0)
    last, paid, exact = y, program.evaluations, EXACT if rough else NEGLIGIBLE
    durations: list[float] = []
    violations: list[float] = []

    def stop_if_converged(z: Array) -> None:
        # SLSQP's own stop criterion is stricter than the accuracy of the integration.
        nonlocal last, paid
        shot = program.shoot(z)
        violation = np.inf if shot is None else _violation(shot)
        durations.append(float(cost @ z) if violation < exact else np.inf)
        violations.append(violation)
        if durations[-1] <= min(durations):
            last = z.copy()
        budget.spend(program.evaluations - paid)
        paid = program.evaluations
        for steps, progress in STOPS[: 1 + rough]:
            before = durations[-1 - steps] if len(durations) > steps else np.inf
            if before - min(durations[-steps:]) < progress:
                raise StopIteration
        if max(exact, FALL * min(violations[:-SLOW], default=np.inf)) < violation:
            raise StopIteration

    # SciPy before 1.16 passes on what its callback raises.
    with suppress(StopIteration):
        found = minimize(
            lambda z: float(cost @ z),
            y,
            jac=lambda z: cost,
            method="SLSQP",
            bounds=list(zip(low, high, strict=True)),
            constraints=_constraints(program, first),
            callback=stop_if_converged,
            options={"maxiter": ITERATIONS, "ftol": 1e-11},
        )
        logger.debug("%s after %d iterations", found.message, found.nit)
    return np.asarray(np.clip(last, low, high))


def _independent(rows: Array) -> Array:
    """Matrix from equations to independent combinations of them, as SLSQP requires.

    Dependent equations belong to components of a goal that the arm cannot change, such
    as its height for an arm that moves in a plane.

    Args:
        rows: Jacobian of the equations, shape (e, size).
    """
    left, sizes, _ = np.linalg.svd(rows, full_matrices=False)
    rank = int(np.sum(sizes > DEPENDENT * np.max(sizes, initial=1e-300)))
    if rank == rows.shape[0]:
        return np.eye(rank)
    return np.asarray(left[:, :rank].T)


def polish(
    optimised: OptimisedArcs, budget: Budget, total: int
) -> OptimisedArcs | None:
    """Drop arcs of zero length and solve again, until no arc has zero length.

    Returns:
        The optimised arcs; None if no motion was found that keeps goal and limits.
    """
    system, found = optimised.program.system, None
    for _ in range(CLEANINGS):
        last = found or optimised
        arcs = last.arcs.cleaned().saturated()
        same = found is not None and arcs.count == found.arcs.count
        if same or not arcs.duration:
            break
        after = solve_lengths(system, arcs, last.states, budget, total)
        if after is None or (found is not None and not after.feasible):
            break
        found = after
    return found if found is not None and found.feasible else None


def improve(optimised: OptimisedArcs, budget: Budget, total: int) -> OptimisedArcs:
    """Change the structure of optimised arcs until no change gains time."""
    system = optimised.program.system
    for _ in range(CHANGES):
        T, arcs = optimised.duration, optimised.arcs
        least = PROMISE * T
        changes = find_changes(optimised.program, optimised.y, optimised.shot, least)
        if not changes:
            break
        # The last arc first, as a change may insert arcs.
        for change in reversed(changes):
            arcs = arcs.divided(change.arc, change.shares, change.edits)
        found = solve_lengths(system, arcs, optimised.states, budget, total)
        better = None if found is None else polish(found, budget, total)
        if better is None or better.duration >= T * (1.0 - PROGRESS):
            break
        optimised = better
    return optimised


def refine_arcs(
    system: ProblemFunctions, arcs: Arcs, states: StateFunction, budget: Budget
) -> OptimisedArcs | None:
    """Find the arcs of a locally time-optimal motion from approximate arcs.

    Args:
        system: The functions of the problem.
        arcs: The approximate arcs.
        states: States (q, v) of a similar motion as a function of times, shape (m,) to
            (m, 2n).
        budget: Budget of evaluations and time.

    Returns:
        The optimised arcs; None if no motion was found that keeps goal and limits.
    """
    found = solve_lengths(system, arcs, states, budget, FEWER_STEPS)
    if found is None:
        return None
    cleaned = polish(found, budget, FEWER_STEPS) or found
    return improve(cleaned, budget, FEWER_STEPS) if cleaned.feasible else None


def sharpen(optimised: OptimisedArcs) -> OptimisedArcs:
    """Halve the integration steps until the duration converges.

    This has a budget of its own, of which it needs a small part.
    """
    budget = Budget()
    for total in STEPS:
        finer = polish(optimised, budget, total)
        if finer is None:
            break
        change = abs(finer.duration / optimised.duration - 1.0)
        if change > ACCURACY and total <= CHANGED_STEPS:
            # The motion violated a limit between the coarser steps, at which an arc may
            # have to be inserted.
            finer = improve(finer, Budget(), total)
        optimised = finer
        if change < ACCURACY:
            break
    return optimised
