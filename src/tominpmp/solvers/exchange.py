"""Rows between the nodes join the running iteration.

Constraints are rows at chosen instants. As the duration settles the motion is looked at
between them, at first while it is rough, and what is missing becomes rows of the next
linear program (semi-infinite exchange, Hettich and Kortanek, 1993); trust region and
weights of the merit stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.friction import OVERLOAD
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.restoration import cured
from tominpmp.status import Status
from tominpmp.transcription.base import Program
from tominpmp.transcription.exchange import revised
from tominpmp.transcription.program import NonlinearProgram

# Rows are looked for when the duration changes by less than such a share of it in an
# iteration; after each time, by less than this share of what it was then.
ROUGH, FINER = 1e-2, 0.1
# Or once rows have joined, when what they asked for is done but for this, and duration
# has not changed by more than this share of it: they seldom move the motion.
DONE, UNMOVED = 1e-3, 1e-3
# Where rows are violated by so much, more of them between the nodes would not help.
FAR = 1e-2
# Iterations that rows give to what they have joined, and how often.
ITERATIONS, EXTENSIONS = 25, 12
# Rows that join may need a step of this share of the usual one at least.
LEAST_RADIUS = 0.1

Revise = Callable[[Program, Array], tuple[Program, Array] | None]


def with_missing_rows(
    program: Program, z: Array, overload: float = OVERLOAD
) -> tuple[Program, Array] | None:
    """A program with the rows that an iterate shows to be missing, and the iterate.

    Args:
        program: The program.
        z: Its iterate.
        overload: Relative excess of torques that is let pass.

    Returns:
        Both; None if nothing is missing.
    """
    assert isinstance(program, NonlinearProgram)  # noqa: S101
    changed = revised(program, z, overload)
    return None if changed is None else (changed[0].at(changed[1]), changed[1])


@dataclass(frozen=True)
class RowExchange:
    """When a running iteration looks between its rows, and what finds those missing.

    Attributes:
        level: Change of the duration in an iteration, as a share of it, below which the
            motion is looked at.
        extensions: How often rows have joined and given it more iterations.
        joined_at: Duration when rows joined last [s]; None while none have.
        longest: Motions that last longer are not looked at [s].
        light: Once the iteration has settled violations of rows that join are left to
            slowing down, if they are no larger than this.
        revise: Gives the program with all that an iterate shows to be missing, and the
            iterate within its bounds; None if nothing is.
    """

    level: float = ROUGH
    extensions: int = 0
    joined_at: float | None = None
    longest: float = np.inf
    light: float = 0.0
    revise: Revise = with_missing_rows

    def due(self, iterate: Iterate, status: Status | None) -> bool:
        """Whether it is time to look at the motion.

        Args:
            iterate: Where the iteration stands.
            status: How the iteration is to end; None if it goes on.
        """
        if status not in (None, Status.CONVERGED) or iterate.duration > self.longest:
            return False
        if iterate.violation > FAR or not iterate.gains:
            return False
        if status is Status.CONVERGED or self._done(iterate):
            return True
        return iterate.gains[-1] < self.level * iterate.duration

    def _done(self, iterate: Iterate) -> bool:
        """Whether what rows asked for that have joined is done."""
        if self.joined_at is None or iterate.violation > DONE:
            return False
        return abs(iterate.duration - self.joined_at) <= UNMOVED * self.joined_at

    @property
    def looked(self) -> RowExchange:
        """The same once the motion was looked at."""
        return replace(self, level=FINER * self.level, joined_at=None)

    def enough(
        self, program: Program, iterate: Iterate, status: Status | None, limit: float
    ) -> bool:
        """Whether slowing down is the cure for what rows that have joined show.

        Args:
            program: The program with these rows.
            iterate: Where the iteration stands.
            status: How it is to end; None if it goes on.
            limit: Largest violation that is let pass.
        """
        settled = status is Status.CONVERGED and self.light > 0.0
        return settled and cured(program, iterate, self.light, limit) is not None

    def extended(
        self, iterate: Iterate, limit: int, count: int
    ) -> tuple[RowExchange, int]:
        """The same once rows have joined, and the limit on the iterations.

        Args:
            iterate: Where the iteration stands.
            limit: The limit by now.
            count: Iterations that were made.
        """
        more = replace(self, joined_at=iterate.duration)
        if self.extensions == EXTENSIONS:
            return more, limit
        more = replace(more, extensions=self.extensions + 1)
        return more, max(limit, count + ITERATIONS)

    def joined(
        self, program: Program, iterate: Iterate
    ) -> tuple[Program, Iterate] | None:
        """Program and iterate with the rows that are missing; None if none are."""
        changed = self.revise(program, iterate.z)
        if changed is None:
            return None
        program, z = changed
        radius = max(iterate.region.radius, LEAST_RADIUS)
        region = replace(iterate.region, radius=radius)
        return program, replace(iterate.on(program, z), region=region, gains=())
