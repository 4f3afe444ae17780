"""Row exchange: rows between the nodes join the running iteration.

Constraints hold at all times but are rows at chosen instants only. After each accepted
step that nearly satisfies its rows, the motion is checked between these instants, and
violated constraints become rows of the next program (exchange method of semi-infinite
programming, Hettich and Kortanek, 1993). The trust region and the penalty weights are
kept. An iteration that is about to end is checked, too, and continues if rows are
missing. Checks that wait until the objective settles take a quarter more iterations on
the golden set, and twice as many for a Fetch in clutter.

Missing rows also join the iterates of stopped plans, whose feasibility is restored
without an objective (:func:`restored`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from tominpmp.arrays import Array
from tominpmp.solvers.iterate import NEGLIGIBLE, Iterate
from tominpmp.solvers.loop import ITERATIONS, SETTLED_RADIUS, Loop
from tominpmp.solvers.objective import RESTORABLE, RESTORATIONS
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import check
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import LONGEST

# How often rows may join at the end of an iteration.
EXTENSIONS = 12
# Least trust-region radius, as a share of the initial one, after rows have joined. If
# the motion is nearly optimal without them, it is the largest radius instead, and
# SETTLED_RADIUS the least: a step uses the whole trust region for unknowns that the
# duration leaves free, and the violations that it causes grow with the square of the
# radius.
LEAST_RADIUS = 0.1
# A motion is nearly optimal if the objective has changed by at most this share since
# rows last joined. Each exchange then halves the radius: reversals of joints with dry
# friction would otherwise move on, and with them the missing rows.
SETTLED = 1e-4
# Violation beyond which a restoration diverges, unless it began with a larger one: in
# seven plans, those that converged rose to 0.32 at most, and others beyond 20 within
# three steps.
DIVERGED = 10.0

Revise = Callable[[NonlinearProgram, Array], tuple[NonlinearProgram, Array] | None]


def _with_missing_rows(
    program: NonlinearProgram, z: Array
) -> tuple[NonlinearProgram, Array] | None:
    """Add missing rows to a program, and update its directions of friction.

    Args:
        program: The program.
        z: Its iterate.

    Returns:
        The changed program and the iterate within its bounds; None without a change.
    """
    turned = program.transcription.with_signs_of(z)
    if turned is not None:
        program, z = replace(program, transcription=turned[0]), turned[1]
    more = exchanged(program, z)
    if more is None and turned is None:
        return None
    return (more or program).at(z), z


@dataclass(frozen=True)
class RowExchange:
    """When an iteration is checked between its rows, and how missing rows are found.

    Attributes:
        extensions: How often rows have joined at the end of the iteration.
        joined_at: Objective when rows last joined; infinite before.
        radius: Least trust-region radius after rows have joined, or the largest one for
            a nearly optimal motion.
        longest: Motions with a longer duration are not checked [s].
        revise: Gives the program with the rows that are missing at an iterate, and the
            iterate within its bounds; None if no rows are missing.
    """

    extensions: int = 0
    joined_at: float = math.inf
    radius: float = LEAST_RADIUS
    longest: float = LONGEST
    revise: Revise = _with_missing_rows

    def due(self, loop: Loop, status: Status | None) -> bool:
        """Whether an exchange is due.

        Args:
            loop: The iteration.
            status: Status with which it is about to end; None if it continues.
        """
        state = loop.state
        if status in STOPPED or loop.dropped or state.duration > self.longest:
            return False
        # Without an accepted step a check would find the same violations again. More
        # rows make an infeasible program no better.
        moved = loop.outcome is not None and loop.outcome.accepted
        new = moved if status is None else status is not Status.INFEASIBLE
        return new and state.violation <= RESTORABLE

    def join(
        self, loop: Loop, status: Status | None
    ) -> tuple[RowExchange, Status | None]:
        """Check the motion between its rows, and add missing rows.

        Args:
            loop: The iteration, which continues with these rows.
            status: Status with which it is about to end; None if it continues.

        Returns:
            The updated exchange, and the new status: None to continue.
        """
        changed = self.revise(loop.program, loop.state.z)
        if changed is None:
            return self, status
        if status is not None and self.extensions == EXTENSIONS:
            # The iteration has settled, but rows are still missing.
            settled = status is Status.CONVERGED
            return self, Status.ITERATION_LIMIT if settled else status
        loop.program, z = changed
        joined = loop.state.on(loop.program, z)
        value = loop.objective.value(loop.program, joined.z, joined.values)
        settled = abs(self.joined_at - value) <= SETTLED * value
        limit = max(0.5 * self.radius, SETTLED_RADIUS) if settled else self.radius
        radius = max(joined.radius, limit)
        if settled:
            radius = min(max(math.sqrt(joined.violation), SETTLED_RADIUS), limit)
        loop.state, loop.best = replace(joined, radius=radius, gains=()), None
        loop.extended_limit = len(loop.history) + ITERATIONS
        extensions = self.extensions + (status is not None)
        return replace(self, extensions=extensions, joined_at=value, radius=limit), None


def restored(
    program: NonlinearProgram, state: Iterate
) -> tuple[NonlinearProgram, Iterate]:
    """Restore feasibility by Newton's method, which moves an iterate to all its rows.

    Of the steps that satisfy the equations and the violated rows by their
    linearisation, each changes the unknowns and the values of the other rows least.
    Unknowns are measured by the distance to their bounds (affine scaling; Coleman and
    Li, 1996), so that those at a bound stay there. Once all rows are satisfied, those
    that are missing between them join.

    Args:
        program: The program.
        state: The iterate.

    Returns:
        The program with the rows that have joined it, and the iterate with the smallest
        violation of them on the way.

    Raises:
        Stop: If it is time to stop.
    """
    iterates, required = [state], np.array(False)
    for _ in range(2 * RESTORATIONS):
        rows, z, values = program.rows, iterates[-1].z, iterates[-1].values
        off = values - np.clip(values, rows.lower, rows.upper)
        violation = np.max(np.abs(off), initial=0.0)
        if violation > max(iterates[0].violation, DIVERGED):
            break
        check()
        if violation <= NEGLIGIBLE:
            more = exchanged(program, z)
            if more is None:
                break
            program, iterates, required = more, [state.on(more, z)], np.array(False)
            continue
        required = required | (off != 0.0) | (rows.lower == rows.upper)
        # Violations are of second order in the step that has caused them.
        radius = math.sqrt(violation)
        steps = program.step_bounds(z, radius)
        near, matrix, (lower, upper), _ = program.linearize(z, values, steps)
        room = np.minimum(upper, -lower) / radius
        matrix = matrix @ sp.diags(room)
        own, other = matrix[required[near]], matrix[~required[near]]
        # A pose has more components than an arm of five joints can change.
        slack = NEGLIGIBLE * sp.identity(own.shape[0])
        hessian = sp.identity(z.size) + other.T @ other
        system = sp.bmat([[hessian, own.T], [own, -slack]], format="csc")
        change = np.append(np.zeros(z.size), -off[near[required[near]]])
        step = room * spsolve(system, change)[: z.size]
        iterates.append(state.on(program, z + np.clip(step, lower, upper)))
    return program, min(iterates, key=lambda item: item.violation)
