"""Rows between the nodes join the running iteration.

Constraints are rows at chosen instants. As the objective settles the motion is looked
at between them, at first while it is rough, and what is missing becomes rows of the
next program (semi-infinite exchange, Hettich and Kortanek, 1993); trust region and
weights of the merit stay as they are. An iteration that ends is looked at in any case,
and goes on where rows are missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from tominpmp.arrays import Array
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.solvers.loop import Loop
from tominpmp.status import STOPPED, Status
from tominpmp.transcription.exchange import exchanged
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import LONGEST

# Rows are looked for when the merit changes by less than such a share of the duration
# in an iteration; after each time, by less than this share of what it was then.
ROUGH, FINER = 1e-2, 0.1
# Or once rows have joined, when what they asked for is done but for this, and duration
# has not changed by more than this share of it: they seldom move the motion.
DONE, UNMOVED = 1e-3, 1e-3
# Where rows are violated by so much, more of them between the nodes would not help.
FAR = 1e-2
# Iterations that rows give to what they have joined, and how often.
ITERATIONS, EXTENSIONS = 25, 12
# Rows that join on the way may need a step of this share of the usual one at least. A
# motion that was nearly optimal without them is mended with this share at most: all of
# it is used for unknowns that the duration leaves free, and what that breaks anew goes
# with its square.
LEAST_RADIUS, SMALLEST = 0.1, 0.01

Revise = Callable[[NonlinearProgram, Array], tuple[NonlinearProgram, Array] | None]


def with_missing_rows(
    program: NonlinearProgram, z: Array, effort_tolerance: float = EFFORT_TOLERANCE
) -> tuple[NonlinearProgram, Array] | None:
    """A program with missing rows and updated assumptions, and the iterate.

    Args:
        program: The program.
        z: Its iterate.
        effort_tolerance: Tolerated relative excess of torques; below zero, a margin
            that torques must keep.

    Returns:
        The program and the iterate within its bounds; None if nothing has to change.
    """
    turned = program.transcription.turned(z)
    if turned is not None:
        program, z = replace(program, transcription=turned[0]), turned[1]
    more = exchanged(program, z, effort_tolerance)
    if more is None and turned is None:
        return None
    return (more or program).at(z), z


@dataclass(frozen=True)
class RowExchange:
    """When an iteration looks between its rows, and what finds those missing.

    Attributes:
        level: Merit gained in an iteration, as a share of the duration, below which the
            motion is looked at; 0 looks only where the iteration ends.
        extensions: How often rows have joined and given it more iterations.
        joined_at: Duration when rows joined last [s]; None while none have.
        longest: Motions that last longer are not looked at [s].
        light: Once the iteration has ended violations of rows that join are left to
            slowing down, if they are no larger than this.
        revise: Gives the program with all that an iterate shows to be missing, and the
            iterate within its bounds; None if nothing is.
    """

    level: float = ROUGH
    extensions: int = 0
    joined_at: float | None = None
    longest: float = LONGEST
    light: float = 0.0
    revise: Revise = with_missing_rows

    def due(self, loop: Loop, status: Status | None) -> bool:
        """Whether it is time to look at the motion.

        Args:
            loop: The iteration.
            status: How it is to end; None if it goes on.
        """
        state = loop.state
        given_up = loop.dropped or loop.shown is Status.STALLED
        if status in STOPPED or given_up or state.duration > self.longest:
            return False
        if status is not None:
            return loop.best is not None or state.violation <= FAR
        # What has not moved since it was looked at would show nothing new.
        moved = loop.outcome is not None and loop.outcome.accepted
        if not (moved and state.gains) or state.violation > FAR:
            return False
        return self._done(loop) or state.gains[-1] < self.level * state.duration

    def _done(self, loop: Loop) -> bool:
        """Whether what rows asked for that have joined is done."""
        if self.joined_at is None or loop.state.violation > DONE:
            return False
        changed = abs(loop.state.duration - self.joined_at)
        return changed <= UNMOVED * self.joined_at

    def look(
        self, loop: Loop, status: Status | None
    ) -> tuple[RowExchange, Status | None]:
        """Look at the motion, and have the rows join that are missing.

        Args:
            loop: The iteration, which goes on with these rows.
            status: How it is to end; None if it goes on.

        Returns:
            The exchange once it has looked, and how the iteration is to end now.
        """
        looked = replace(self, level=FINER * self.level, joined_at=None)
        changed, reached = self.revise(loop.program, loop.state.z), loop.state
        if changed is None and status is not None:
            loop.end(status)
            if loop.state is not reached:
                changed = self.revise(loop.program, loop.state.z)
        if changed is None:
            return looked, status
        if status is not None and self.extensions == EXTENSIONS:
            # It has settled on rows that are not all that it needs.
            settled = status is Status.CONVERGED
            return looked, Status.ITERATION_LIMIT if settled else status
        loop.program, z = changed
        joined = loop.state.on(loop.program, z)
        radius = max(joined.radius, LEAST_RADIUS)
        if self.level == 0.0:
            radius = min(max(math.sqrt(joined.violation), SMALLEST), LEAST_RADIUS)
        loop.state, loop.best = replace(joined, radius=radius, gains=()), None
        looked = replace(looked, joined_at=loop.state.duration)
        if self.extensions < EXTENSIONS:
            looked = replace(looked, extensions=self.extensions + 1)
            loop.granted = len(loop.history) + ITERATIONS
        if status is None:
            return looked, None
        loop.state = replace(loop.state, raises=0)
        # Slowing down is a cure for light violations, and where any motion will do.
        slower, objective = None, loop.objective
        if objective.any_will_do:
            slower = objective.better(loop.program, loop.state, None)
        elif self.light > 0.0:
            slower = objective.cured(loop.program, loop.state, self.light)
        if slower is None:
            return looked, None
        loop.state = loop.best = slower
        return looked.look(loop, status)
