"""Optimal switching times: arcs of exact length in place of intervals of a grid.

A structure of arcs is read off a motion; the lengths are optimised by sequential
quadratic programming (Kraft, 1988), arcs that vanish are dropped and others put in
where Pontryagin's conditions are violated, until there is nothing left to change.
Integration steps are halved until the duration no longer notices: lengths are never
traded for errors of integration.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tominpmp.arrays import Array, IntArray
from tominpmp.exact.shooting import ArcProgram, Shot
from tominpmp.exact.structure import Arcs
from tominpmp.exact.switching_functions import Change, find_changes
from tominpmp.stopping import EVALUATIONS, Budget
from tominpmp.transcription.base import NOT_INTEGRATED
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

States = Callable[[Array], Array]

# Steps over the whole motion while arcs are looked for, and in the end; what the
# duration may change by when they are doubled, relatively.
FEWER_STEPS = 30
STEPS = 60
ACCURACY = 1e-7
MOST_STEPS = 960
# With more steps the structure is no longer changed.
CHANGED_STEPS = 240
# Steps of an arc at least.
STEPS_OF_ARC = 2
# What the goal may be missed by, and limits passed by, in scaled units.
EXACT = 1e-7
SLACK = 1e-6
ITERATIONS = 150
# Equations whose gradients depend on each other but for this share are one too many.
DEPENDENT = 1e-10
# How often arcs that have vanished are left out at most.
CLEANINGS = 4
# Rounds of looking at limits that a solution has come near to.
LOOKS = 4
# Largest number of changes of the structure; what one must promise, as a share of the
# duration, and bring.
CHANGES = 25
PROMISE = 1e-7
PROGRESS = 1e-8
# Lengths are at most this much longer than the whole motion was.
LONGEST = 3.0
# Relative progress and misses that count as zero, and how often in a row.
STILL = 1e-10
STILL_STEPS = 2
# While arcs are looked for, relative progress that counts as zero, and the number of
# steps it is measured over.
SLOW = 1e-6
SLOW_STEPS = 6


@dataclass(frozen=True, eq=False)
class OptimisedArcs:
    """Arcs whose lengths are optimal, as far as their kinds go.

    Attributes:
        program: The program.
        y: Its unknowns.
        shot: The motion.
        miss: What the goal is missed by, in the scaled units of the rows.
        excess: What limits are passed by.
    """

    program: ArcProgram
    y: Array
    shot: Shot
    miss: float
    excess: float

    @property
    def arcs(self) -> Arcs:
        """The arcs."""
        return self.program.unpack(self.y)

    @property
    def duration(self) -> float:
        """T [s]."""
        return self.arcs.duration

    @property
    def feasible(self) -> bool:
        """Whether goal and limits are kept."""
        return self.miss <= EXACT and self.excess <= SLACK

    def states(self, times: Array) -> Array:
        """States (q, v) at times, good enough to begin with, shape (m, 2n)."""
        arcs, motion = self.arcs, self.shot.motion
        t = np.concatenate([[0.0], self.program.sample_times(arcs).ravel()])
        x = np.vstack([motion.x_start, motion.stages.reshape(t.size - 1, -1)])
        return np.stack([np.interp(times, t, column) for column in x.T], axis=1)


def steps_of(arcs: Arcs, total: int) -> IntArray:
    """Number of steps of each arc for a number over the whole motion."""
    share = arcs.lengths / arcs.duration
    return np.maximum(np.ceil(total * share), STEPS_OF_ARC).astype(np.int64)


def solve_lengths(
    system: ProblemFunctions,
    arcs: Arcs,
    states: States | None,
    budget: Budget,
    total: int = STEPS,
) -> OptimisedArcs | None:
    """Find optimal lengths and free torques for arcs of given kinds and rough lengths.

    It begins with the states (q, v) of a motion near by, as a function from times of
    shape (m,) to (m, 2n), or by integrating the arcs; ``total`` steps are taken over
    the whole motion. None if the motion cannot be integrated.
    """
    program = ArcProgram(system, arcs, steps_of(arcs, total))
    times = program.sample_times(arcs)
    y = program.pack()
    if states is not None:
        program.guess = states(times.ravel()).reshape(*times.shape, -1)
    shot = program.shoot(y)
    excess = np.inf
    for _ in range(LOOKS):
        if shot is None or budget.spent:
            return None
        program.watch(program.look(shot.motion))
        y = _minimize(program, y, budget, rough=total <= FEWER_STEPS)
        shot = program.shoot(y)
        excess = np.inf if shot is None else program.excess(shot.motion, 0.1 * SLACK)
        if excess <= SLACK:
            break
    if shot is None:
        return None
    return OptimisedArcs(program, y, shot, _miss(shot), excess)


def _miss(shot: Shot) -> float:
    """What the goal is missed by, and limits passed by beyond the slack."""
    return max(
        float(np.max(np.abs(shot.equal), initial=0.0)),
        float(np.max(-shot.room, initial=0.0)) - SLACK,
    )


def _constraints(program: ArcProgram, first: Shot) -> list[dict[str, Any]]:
    """Equations and limits of a program as SLSQP takes them."""
    # In place of motions that cannot be integrated.
    far = replace(
        first,
        equal=np.full_like(first.equal, NOT_INTEGRATED),
        by_equal=np.zeros_like(first.by_equal),
        room=np.full_like(first.room, -NOT_INTEGRATED),
        by_room=np.zeros_like(first.by_room),
    )
    basis = _independent(first.by_equal)

    def shot(z: Array) -> Shot:
        return program.shoot(z) or far

    equations = {
        "type": "eq",
        "fun": lambda z: basis @ shot(z).equal,
        "jac": lambda z: basis @ shot(z).by_equal,
    }
    limits = {
        "type": "ineq",
        "fun": lambda z: shot(z).room,
        "jac": lambda z: shot(z).by_room,
    }
    return [equations, limits] if first.room.size else [equations]


def _minimize(
    program: ArcProgram, y: Array, budget: Budget, *, rough: bool = False
) -> Array:
    """Least duration from some unknowns on, with the limits that are watched.

    A rough one ends where hardly anything is gained any more.
    """
    count, size = program.arcs.count, program.size
    cost = np.concatenate([np.ones(count), np.zeros(size - count)])
    first = program.shoot(y)
    assert first is not None  # noqa: S101
    low = np.concatenate([np.zeros(count), -np.ones(size - count)])
    high = np.concatenate([np.full(count, LONGEST), np.ones(size - count)])
    last, still_steps, paid = y, 0, program.evaluations
    durations: list[float] = []

    def follow(z: Array) -> None:
        # SLSQP's own test asks for more digits than there are.
        nonlocal last, still_steps, paid
        shot = program.shoot(z)
        miss = np.inf if shot is None else _miss(shot)
        still = abs(float(cost @ (z - last))) < STILL and miss < STILL
        still_steps = still_steps + 1 if still else 0
        durations.append(float(cost @ z) if miss < EXACT else np.inf)
        slow = (
            durations[-SLOW_STEPS] - durations[-1] if len(durations) > SLOW_STEPS else 1
        )
        if rough and slow < SLOW:
            raise StopIteration
        last = z.copy()
        budget.spend(program.evaluations - paid)
        paid = program.evaluations
        if still_steps >= STILL_STEPS:
            raise StopIteration

    try:
        found = minimize(
            lambda z: float(cost @ z),
            y,
            jac=lambda z: cost,
            method="SLSQP",
            bounds=list(zip(low, high, strict=True)),
            constraints=_constraints(program, first),
            callback=follow,
            options={"maxiter": ITERATIONS, "ftol": 1e-11},
        )
    except StopIteration:
        return np.asarray(np.clip(last, low, high))
    logger.debug("%s after %d iterations", found.message, found.nit)
    return np.asarray(np.clip(found.x, low, high))


def _independent(rows: Array) -> Array:
    """What combines equations to as many as are independent, which SLSQP asks for.

    Others are those of a goal that the arm cannot leave, as its height for an arm that
    moves in a plane.
    """
    left, sizes, _ = np.linalg.svd(rows, full_matrices=False)
    rank = int(np.sum(sizes > DEPENDENT * np.max(sizes, initial=1e-300)))
    if rank == rows.shape[0]:
        return np.eye(rank)
    return np.asarray(left[:, :rank].T)


def polish(
    system: ProblemFunctions, optimised: OptimisedArcs, budget: Budget, total: int
) -> OptimisedArcs | None:
    """Solve again without the arcs that have vanished, until none vanishes any more."""
    found: OptimisedArcs | None = None
    for _ in range(CLEANINGS):
        last = found or optimised
        arcs = last.arcs.cleaned().saturated()
        if found is not None and arcs.count == found.arcs.count:
            break
        after = solve_lengths(system, arcs, last.states, budget, total)
        if after is None or (found is not None and not after.feasible):
            break
        found = after
    return found


def improve(
    system: ProblemFunctions,
    optimised: OptimisedArcs,
    budget: Budget,
    total: int = STEPS,
) -> OptimisedArcs:
    """Change the structure of optimised arcs until nothing is left to gain."""
    for _ in range(CHANGES):
        T = optimised.duration
        changes = find_changes(
            optimised.program, optimised.y, optimised.shot, PROMISE * T
        )
        better = _changed(system, optimised, changes, budget, total)
        if better is None or better.duration >= T * (1.0 - PROGRESS):
            break
        optimised = better
    return optimised


def _changed(
    system: ProblemFunctions,
    optimised: OptimisedArcs,
    changes: Sequence[Change],
    budget: Budget,
    total: int,
) -> OptimisedArcs | None:
    """Arcs with changes of the structure, solved again; None if that fails."""
    if not changes:
        return None
    arcs = optimised.arcs
    for change in sorted(changes, key=lambda change: -change.arc):
        arcs = change.made(arcs)
    found = solve_lengths(system, arcs, optimised.states, budget, total)
    if found is not None:
        found = polish(system, found, budget, total)
    return found if found is not None and found.feasible else None


def refine_arcs(
    system: ProblemFunctions, arcs: Arcs, states: States, budget: Budget
) -> OptimisedArcs | None:
    """Find the arcs of a locally time-optimal motion from rough ones.

    States (q, v) of a motion near by are a function from times of shape (m,) to (m,
    2n). None if no motion was found that keeps goal and limits.
    """
    for rough in (arcs, arcs.loosened()):
        found = solve_lengths(system, rough, states, budget, FEWER_STEPS)
        if found is not None and found.feasible:
            polished = polish(system, found, budget, FEWER_STEPS)
            if polished is not None and polished.feasible:
                found = polished
            return improve(system, found, budget, FEWER_STEPS)
    return None


def sharpen(
    system: ProblemFunctions, optimised: OptimisedArcs, budget: Budget
) -> OptimisedArcs:
    """Halve the integration steps until the duration does not notice.

    This takes little of the budget, and its end is paid for.
    """
    total = STEPS // 2
    reserve = Budget(max(budget.remaining, EVALUATIONS // 4))
    while total < MOST_STEPS:
        total *= 2
        finer = polish(system, optimised, reserve, total)
        if finer is None or not finer.feasible:
            break
        change = abs(finer.duration / optimised.duration - 1.0)
        if change > ACCURACY and total <= CHANGED_STEPS:
            # Between coarser steps it had passed a limit, where it may rest now.
            finer = improve(system, finer, reserve, total)
        optimised = finer
        if change < ACCURACY:
            break
    return optimised
