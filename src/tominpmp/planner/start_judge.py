"""Judge of starts: when one is let go, on the coarse grid and on the one asked for.

It remembers the motions that were found, and tells of an iteration whether it comes to
one of them, to nothing, or to one that is not faster.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.planner.coarse_grids import ITERATIONS, SPEED_LOSS, TOLERANCE
from tominpmp.planner.progress import Judge, Progress
from tominpmp.planner.rough_motions import NEARLY, Rough, same, shape_of
from tominpmp.status import IterationRecord, Status
from tominpmp.transcription.problem_functions import ProblemFunctions

# Iterations after which a guess is let go that has led to no motion, and before that to
# nothing that is at all near one. Among obstacles rows that join it give it the latter
# anew: a motion that was all right between the former ones breaks them at first.
PATIENCE, FIRST_PATIENCE, HOPELESS = 15, 8, 0.3
# Violation of one that is gone on with at once, as no motion is faster by much.
SMALL = 1e-3
# Change of the duration that is none, as a share of it, in so many iterations; and of
# one that rows between the nodes have joined, of which the asked grid makes more.
AT_REST, REST = 3e-4, 2
AT_REST_WITH_ROWS = TOLERANCE
# While a motion violates more than this share it stands still where its trust region
# has come down to this share.
STUCK = 0.02
# What further iterations may gain altogether, in gains of the last one.
LEFT = 3.0
# A motion goes astray on the asked grid that becomes so many times as slow as it was.
ASTRAY = 3.0
# What a motion has to promise beyond the best one to be finished, as a share of T.
PROMISE = 0.003


class StartJudge:
    """Lets starts go that lead nowhere that is new, or faster.

    Args:
        system: The problem.
        progress: Records of the present start, and the best duration so far.

    Attributes:
        known: Motions on coarse grids, all different.
        ends: Shapes of the motions that were finished.
    """

    def __init__(self, system: ProblemFunctions, progress: Progress) -> None:
        self.system, self.progress = system, progress
        self.known: list[Rough] = []
        self.ends: list[Array] = []
        self._rows = self._joined = 0

    def knows(self, shape: Array) -> bool:
        """Whether there is a motion of that shape on the coarse grid."""
        return any(same(shape, one.shape) for one in self.known)

    def enough(self, record: IterationRecord) -> Status | None:
        """End a start that takes too long, or comes to a motion which is known.

        Or to one that next to none can beat: what is left is done on the asked grid.
        """
        self._see_rows()
        if len(self.progress.records) >= self._most(record):
            return Status.ITERATION_LIMIT
        if record.violation > NEARLY:
            return Status.STALLED if record.radius < STUCK else None
        if self._unbeaten(record) or self._outdone():
            return Status.STALLED
        if self._at_rest:
            return Status.ITERATION_LIMIT
        if not self.known:
            return None
        return Status.STALLED if self.knows(self._shape) else None

    def _see_rows(self) -> None:
        """Remember in which iteration of the present start rows joined it last."""
        count, kept = len(self.progress.records), self.progress.kept
        rows = kept[-1].program.rows.size if kept else 0
        if count <= 1:
            self._joined = 0
        elif rows != self._rows:
            self._joined = count
        self._rows = rows

    def _most(self, record: IterationRecord) -> int:
        """Iterations that the present start may take, as it stands."""
        if record.violation <= NEARLY:
            return ITERATIONS
        most = FIRST_PATIENCE if record.violation > HOPELESS else PATIENCE
        if self._joined and not self.system.alone:
            most = max(most, self._joined + FIRST_PATIENCE)
        return min(most, ITERATIONS)

    @property
    def _shape(self) -> Array:
        """Shape of the motion that the present start has come to."""
        program, iterate, _ = self.progress.kept[-1]
        return shape_of(self.system, program.trajectory(iterate.z))

    @property
    def _at_rest(self) -> bool:
        """Whether the duration hardly changes any more: the asked grid does the rest.

        Among obstacles rows between the nodes have to join first.
        """
        records, little = self.progress.records, AT_REST
        if not self.system.alone:
            if not self._joined or len(records) < self._joined + REST:
                return False
            little = AT_REST_WITH_ROWS
        last = records[-REST - 1 :]
        if len(last) <= REST or last[-2].violation > NEARLY:
            return False
        durations = np.array([record.duration for record in last])
        return bool(np.all(np.abs(np.diff(durations)) < little * durations[1:]))

    def _outdone(self) -> bool:
        """Whether a start will end no faster than one that went before.

        Iterations gain less and less: this one, several times more.
        """
        if self.system.final_configuration is not None or not self.system.alone:
            return False
        best = min((one.duration for one in self.known), default=np.inf)
        if best == np.inf or len(self.progress.records) < 2:
            return False
        before, now = (record.duration for record in self.progress.records[-2:])
        left = LEFT * max(before - now, 0.0)
        return now - left > (1.0 - PROMISE) * best

    def _unbeaten(self, record: IterationRecord) -> bool:
        """Whether next to no motion is faster, once rows between the nodes have joined.

        Before that it may pass through what is between the nodes.
        """
        progress = self.progress
        if record.violation > SMALL or progress.begun is None:
            return False
        if self.system.final_configuration is None or self.system.alone:
            return False
        first, last = progress.begun.program, progress.kept[-1].program
        bound = progress.lower_bound(self.system.problem).T
        joined = last.rows.size > first.rows.size
        return joined and record.duration <= (1.0 + SPEED_LOSS) * bound

    def of_finish(self, rough: Rough) -> Judge:
        """Ends what goes on from a coarse motion: where that leads far astray, or back.

        A motion that passes something between the nodes becomes ever slower as rows
        join it there, 20 times as slow and more, and does not pass it in the end.
        """

        def judge(record: IterationRecord) -> Status | None:
            if record.duration > ASTRAY * rough.duration:
                return Status.STALLED
            return self.comes_back(record) if self.ends else None

        return judge

    def comes_back(self, record: IterationRecord) -> Status | None:
        """End one that comes to a motion which was finished before, or near it.

        Among obstacles it may still get away from there, and past them.
        """
        progress = self.progress
        faster = record.duration < (1.0 - PROMISE) * progress.best
        if faster or record.violation > SMALL or not self.system.alone:
            return None
        shape = self._shape
        near = any(same(shape, end) for end in self.ends)
        return Status.STALLED if near else None
