"""Coarse search: cheap starts on coarse grids, the best of which are finished.

A descent on a few intervals takes a fraction of the time, and is less apt to end in a
poor local optimum than one on the grid that is asked for: obstacles and torque limits
bind at fewer instants. So starts are judged by what they lead to there, and those that
lead to the same motion as others before, or to slower ones, are let go.

Every decision depends on what came before it alone. So whoever asks for more gets what
less would have found, and then more.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.warm_start import warm_start
from tominpmp.motion.curves import states
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Control, Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import MANY_INTERVALS, descend, descended
from tominpmp.planner.plan_state import Kept, PlanState
from tominpmp.planner.rescue import keep_best_on_interrupt, slowed_down
from tominpmp.solvers.objective import TIME_SCALINGS
from tominpmp.status import STOPPED, IterationRecord, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Intervals of a coarse grid.
INTERVALS = 16
# How exactly a coarse motion is found, and in how many iterations.
TOLERANCE, ITERATIONS = 2e-3, 30
# Excess of torques between the rows of coarse grids that is let pass, where the asked
# grid is refined by what is left; 3e-2 would be too much to slow down. Exact switching
# begins with what the coarse grid leads to.
COARSE_EFFORT_TOLERANCE = 1e-2
# Trust region for finishing a coarse motion, as a share of the usual one.
RADIUS = 0.5
# Intervals to finish one with, at most, where torques rule and the grid may follow the
# motion, and joints times intervals: programs of thirty joints take a second each.
TORQUE_INTERVALS, TORQUE_VARIABLES = 80, 640
# What a coarse grid costs, as a share of T, where torques rule and where speeds do.
TORQUE_LOSS, SPEED_LOSS = 0.06, 0.01
# Largest violation of a coarse motion that is finished.
NEARLY = 1e-2
# Iterations after which a start is let go that is not near a motion, since rows between
# the nodes have joined it last: these break a motion that was all right before.
PATIENCE = 12
# While a motion is not near it stands still where its trust region is this small.
STUCK = 0.02
# What further iterations may gain altogether, in gains of the last one.
LEFT = 3.0
# A motion goes astray on the asked grid that becomes so many times as slow: one
# that passes something between the nodes, where rows join it, becomes ever slower.
ASTRAY = 3.0
# What a motion has to promise beyond the best one to be finished, as a share of T.
PROMISE = 0.003
# A timed guess this much slower than a motion that was found is not worth its time.
TOO_SLOW = 1.4
# Instants at which motions are compared, and how near to each other the same ones are
# [rad, or shares of the reach].
SAMPLES = 12
SAME = 0.05


def coarse_grids_apply(system: ProblemFunctions, options: Options) -> bool:
    """Whether coarse grids are for a problem, and for these options."""
    return (
        options.method == "inverse"
        and options.objective == "time"
        and options.intervals >= MANY_INTERVALS
        and not system.parts
    )


def _shape_of(system: ProblemFunctions, motion: Trajectory) -> Array:
    """Configurations at even shares of the duration, scaled, shape (SAMPLES, n)."""
    times = np.linspace(0.0, 1.0, SAMPLES) * motion.duration
    q, _, _ = states(motion.t, motion.q, motion.v, motion.a, times)
    return np.asarray(q / system.step_scale)


def _is_among(shape: Array, others: Iterable[Array]) -> bool:
    """Whether a shape is that of one of other motions."""
    return any(np.max(np.abs(shape - other)) < SAME for other in others)


@dataclass(frozen=True, eq=False)
class CoarseMotion:
    """A motion on a coarse grid.

    Attributes:
        candidate: What led to it.
        guess: What that began with.
        shape: Its shape.
        kept: Its program and iterate.
    """

    candidate: Candidate
    guess: Guess
    shape: Array
    kept: Kept

    @property
    def duration(self) -> float:
        """T on the coarse grid [s]; infinite if it is far from a motion."""
        near = self.candidate.violation <= NEARLY
        return self.candidate.trajectory.duration if near else np.inf


class CoarseSearch:
    """Starts on coarse grids, and what is made of them.

    Where torques rule, even intervals lose least; where speeds and obstacles do, short
    ones at both ends. A weight on the variation of torques leads to better optima on
    the coarse grid; on the fine one it costs 0.1 % of T. If the grid may follow the
    motion anyway, torques get twice the intervals at once: that ends 0.1 to 0.5 % lower
    (six goals).

    Args:
        system: The problem.
        options: Options of the plan.
        progress: Time limit and callback, and the duration of the best motion so far.
        torques: Whether torques rule the motion.

    Attributes:
        known: Motions on coarse grids, all different.
        ends: Shapes of the motions that were finished.
        loss: What the coarse grid costs, as a share of T.
        stopped: Whether it was time to stop.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        options: Options,
        progress: PlanState,
        *,
        torques: bool,
    ) -> None:
        if options.control == "auto":
            control: Control = "linear" if torques else "constant"
            options = replace(options, control=control)
        self.system, self.options, self.progress = system, options, progress
        self.coarse = replace(
            options,
            intervals=INTERVALS,
            refine=None,
            tolerance=max(options.tolerance, TOLERANCE),
            max_iterations=min(options.max_iterations, ITERATIONS),
        )
        self.fine = replace(options, trust_region=RADIUS * options.trust_region)
        if torques:
            self.fine = replace(self.fine, smoothing=options.smoothing or 0.0)
        if torques and system.in_free_space:
            self.coarse = replace(self.coarse, grid="uniform")
            if options.refine == "auto":
                most = min(TORQUE_INTERVALS, TORQUE_VARIABLES // system.n)
                finer = max(options.intervals, min(2 * options.intervals, most))
                self.fine = replace(self.fine, intervals=finer)
        self.loss = TORQUE_LOSS if torques else SPEED_LOSS
        self.known: list[CoarseMotion] = []
        self.ends: list[Array] = []
        self.stopped = False
        self._tried: list[Guess] = []
        self._gains: list[float] = []
        self._rows = self._joined = 0

    # -- on the coarse grid ------------------------------------------------------------

    def rough(self, guess: Guess) -> CoarseMotion | None:
        """Improve a guess on the coarse grid; None if it leads nowhere that is new."""
        if any(guess is one for one in self._tried):
            return None
        self._tried.append(guess)
        progress, system = self.progress, self.system.without_self_collision
        progress.deadline.check()
        progress.begin()
        effort_tolerance = (
            COARSE_EFFORT_TOLERANCE
            if self.options.refine == "auto"
            else EFFORT_TOLERANCE
        )
        solve = partial(
            descend,
            system,
            self.coarse,
            guess,
            progress,
            effort_tolerance=effort_tolerance,
        )
        with progress.judged(self._let_go):
            candidate = keep_best_on_interrupt(
                system.problem, self.options, progress, guess.name, solve
            )
        if candidate is None:
            return None
        shape = _shape_of(system, candidate.trajectory)
        rough = CoarseMotion(candidate, guess, shape, progress.kept[-1])
        self.stopped = candidate.status in STOPPED
        if not self.stopped and (rough.duration == np.inf or self._knows(shape)):
            return None
        self.known.append(rough)
        return None if self.stopped else rough

    def _let_go(self, record: IterationRecord) -> Status | None:
        """End a start that comes to nothing that is new or faster."""
        count, rows = len(self.progress.records), self.progress.kept[-1].program.rows
        if count <= 1 or rows.size != self._rows:
            self._joined = count
        self._rows = rows.size
        if record.violation > NEARLY:
            over = count - self._joined >= PATIENCE or record.radius < STUCK
            return Status.STALLED if over else None
        if self._outdone():
            return Status.STALLED
        known = bool(self.known) and self._knows(self._shape)
        return Status.STALLED if known else None

    @property
    def _shape(self) -> Array:
        """Shape of the motion that the present start has come to."""
        program, iterate, _ = self.progress.kept[-1]
        return _shape_of(self.system, program.trajectory(iterate.z))

    def _knows(self, shape: Array) -> bool:
        return _is_among(shape, (one.shape for one in self.known))

    def _outdone(self) -> bool:
        """Whether a start will end no faster than one that went before.

        Iterations gain less and less: this one, several times more.
        """
        records = self.progress.records
        if self.system.final_configuration is not None or not self.system.in_free_space:
            return False
        best = min((one.duration for one in self.known), default=np.inf)
        if best == np.inf or len(records) < 2:
            return False
        before, now = (record.duration for record in records[-2:])
        left = LEFT * max(before - now, 0.0)
        return now - left > (1.0 - PROMISE) * best

    # -- on the grid that is asked for -------------------------------------------------

    def finished(self, rough: CoarseMotion) -> Candidate | None:
        """Go on from a coarse motion on the grid that is asked for."""
        system, progress, former = self.system, self.progress, rough.candidate
        progress.begin()
        guess = warm_start(system, former.trajectory)
        guess = replace(guess, name=former.name, blocked=rough.guess.blocked)

        def astray(record: IterationRecord) -> Status | None:
            slow = record.duration > ASTRAY * rough.duration
            return Status.STALLED if slow or self._comes_back(record) else None

        solve = partial(descended, system, self.fine, guess, progress)
        with progress.judged(astray):
            candidate = keep_best_on_interrupt(
                system.problem, self.fine, progress, former.name, solve
            )
        if candidate is None or (progress.dropped and self.ends):
            return None
        candidate = candidate.after(former)
        self.stopped = candidate.status in STOPPED
        if candidate.found:
            self._gains.append(rough.duration / candidate.duration - 1.0)
            self.ends.append(_shape_of(system, candidate.trajectory))
        elif self.stopped and progress.best == np.inf:
            candidate = self._replayed(rough, candidate.status)
        progress.best = min(progress.best, candidate.duration)
        logger.info("coarse %.6g s, fine %.6g s", rough.duration, candidate.duration)
        return candidate

    def _comes_back(self, record: IterationRecord) -> bool:
        """Whether one comes to a motion which was finished before, or near it.

        Among obstacles it may still get away from there, and past them.
        """
        faster = record.duration < (1.0 - PROMISE) * self.progress.best
        if faster or record.violation > NEARLY or not self.system.in_free_space:
            return False
        return bool(self.ends) and _is_among(self._shape, self.ends)

    def saved(self) -> Iterator[Candidate]:
        """What there is when it is time to stop: the best coarse motion, replayed."""
        if self.known and self.progress.best == np.inf:
            best = min(self.known, key=lambda one: one.duration)
            ended = self.progress.cut_short or Status.TIME_LIMIT
            yield self._replayed(best, ended)

    def _replayed(self, rough: CoarseMotion, status: Status) -> Candidate:
        """A coarse motion, as slow as it has to be, replayed in a little time."""
        candidate = replace(rough.candidate, status=status)
        with self.progress.saving():
            try:
                slow = None if candidate.found else slowed_down(rough.kept)
                if slow is None:
                    return candidate
                candidate = replace(candidate, layout=None, feasible=True)
                for factor in TIME_SCALINGS:
                    z = slow.program.time_scale(slow.iterate.z, factor)
                    tried = replace(candidate, trajectory=slow.program.trajectory(z))
                    candidate = tried.verified(self.system.problem, self.options)
                    if candidate.found:
                        return candidate
            except (Stop, KeyboardInterrupt) as stop:
                self.progress.stopped(stop)
                candidate = replace(candidate, verification=None)
        return candidate

    # -- what is compared --------------------------------------------------------------

    def descents(self, guesses: Iterable[Guess], wanted: int) -> Iterator[Candidate]:
        """The first motions of a plan.

        Args:
            guesses: The guesses; of those that are wanted the best is finished, and of
                further ones the first that leads to a motion.
            wanted: How many of them are compared.
        """
        source = iter(guesses)
        for guess in itertools.islice(source, wanted):
            best = min((one.duration for one in self.known), default=np.inf)
            if guess.timed and guess.duration > TOO_SLOW * best:
                continue
            self.rough(guess)
            if self.stopped:
                break
        tried: list[CoarseMotion] = []
        while not self.stopped:
            left = [rough for rough in self.known if rough not in tried]
            for rough in sorted(left, key=lambda one: one.duration):
                tried.append(rough)
                candidate = self.finished(rough)
                if candidate is not None:
                    yield candidate
                if self.stopped or (candidate is not None and candidate.found):
                    return
            further = next(source, None)
            if further is None:
                return
            self.rough(further)
        yield from self.saved()

    def compare(self) -> None:
        """Have starts promise only what is less than the coarse motions so far.

        The loss of the coarse grid is that of the motions that were finished then.
        """
        if self._gains:
            self.loss = min(self.loss, max(0.0, *self._gains))

    def probes(self, guesses: Iterable[Guess], patience: int) -> Iterator[Candidate]:
        """Try further guesses, and finish those that promise a faster motion.

        Args:
            guesses: The guesses.
            patience: After so many of them in a row that promise nothing it is enough.
        """
        found: list[CoarseMotion] = []
        in_vain, best = 0, np.inf
        for guess in guesses:
            rough = self.rough(guess)
            if self.stopped:
                yield from self.saved()
                return
            in_vain += 1
            if rough is not None and self._promises(rough):
                found.append(rough)
                if rough.duration < (1.0 - PROMISE) * best:
                    in_vain, best = 0, rough.duration
            if in_vain >= patience:
                break
        for rough in sorted(found, key=lambda one: one.duration):
            if not self._promises(rough):
                return
            candidate = self.finished(rough)
            if candidate is not None:
                yield candidate
            if self.stopped:
                return

    def _promises(self, rough: CoarseMotion) -> bool:
        """Whether a motion may be faster than the best one, once it is finished."""
        promised = rough.duration / (1.0 + self.loss)
        return promised < (1.0 - PROMISE) * self.progress.best
