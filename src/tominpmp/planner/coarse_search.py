"""Coarse search: cheap starts on coarse grids, the best of which are gone on with.

A descent on a few intervals takes a fraction of the time, and is less apt to end in a
poor local optimum than one on the grid that is asked for: obstacles and torque limits
bind at fewer instants. So starts are judged by what they lead to there, and those that
lead to the same motion as others before, or to slower ones, are let go.

Every decision depends on what came before it alone. So whoever asks for more gets what
less would have found, and then more.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tominpmp.constraints.friction import OVERLOAD
from tominpmp.initial_guess.guess import Guess
from tominpmp.initial_guess.warm_start import WarmStart, warm_start
from tominpmp.options import Options
from tominpmp.planner.attempt import Attempt
from tominpmp.planner.coarse_grids import RADIUS, SPEED_LOSS, TORQUE_LOSS, Grids
from tominpmp.planner.direct_solve import solve_and_verify, solve_from_guess
from tominpmp.planner.progress import Progress
from tominpmp.planner.rescue import guarded, slowed_down
from tominpmp.planner.rough_motions import NEARLY, Rough, shape_of
from tominpmp.planner.start_judge import PROMISE, StartJudge
from tominpmp.planner.touching import links_touch
from tominpmp.status import STOPPED, Status
from tominpmp.stopping import Stop
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Excess of torques between the rows of coarse grids that is let pass, where the asked
# grid is refined by what is left; 3e-2 would be too much to slow down. Exact switching
# begins with what the coarse grid leads to.
COARSE_OVERLOAD = 1e-2
# A timed guess this much slower than a motion that was found is not worth its time.
TOO_SLOW = 1.4
# How much slower a coarse motion may have to be, where it is all that there is.
TIME_SCALINGS = (1.0, 1.01, 1.03, 1.1)
# Share of the time that is allowed after which the first motion is replayed at once.
LATE = 0.2


class CoarseSearch:
    """Starts on coarse grids, and what is made of them.

    Args:
        system: The problem.
        options: Options of the plan.
        progress: Time limit and callback, and the duration of the best motion so far.

    Attributes:
        judge: What lets starts go, and remembers the motions that were found.
        tried: What these and others began with.
        loss: What the coarse grid costs, as a share of T.
        stopped: Whether it was time to stop.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        options: Options,
        progress: Progress,
        *,
        torques: bool,
    ) -> None:
        self.system, self.options, self.progress = system, options, progress
        self.grids = Grids.of(system, options, torques)
        self.judge = StartJudge(system, progress)
        self.tried: list[Guess] = []
        self.loss = TORQUE_LOSS if torques else SPEED_LOSS
        self.stopped = False
        self._gains: list[float] = []

    # -- on the coarse grid ------------------------------------------------------------

    def rough(self, guess: Guess) -> Rough | None:
        """Improve a guess on the coarse grid; None if it leads nowhere that is new."""
        if any(guess is one for one in self.tried):
            return None
        self.tried.append(guess)
        progress = self.progress
        progress.deadline.check()
        system = self.system.first_tried
        attempt = self._coarse(system, guess)
        if attempt is None:
            return None
        first, last = progress.kept[0], progress.kept[-1]
        touches = self._touches(attempt)
        if touches and attempt.status not in STOPPED:
            apart = self._parted(attempt, guess)
            if apart is not None:
                attempt, last = apart, progress.kept[-1]
                touches = self._touches(attempt)
        shape = shape_of(system, attempt.trajectory)
        rough = Rough(attempt, guess, shape, last, first, touches)
        if attempt.status in STOPPED:
            self.stopped = True
            self.judge.known.append(rough)
            return None
        if rough.duration == np.inf or self.judge.knows(rough.shape):
            return None
        self.judge.known.append(rough)
        return rough

    def _coarse(
        self, system: ProblemFunctions, guess: Guess, radius: float = 1.0
    ) -> Attempt | None:
        """A guess, improved on the coarse grid with a share of the trust region."""
        options, progress = self.grids.coarse, self.progress
        options = replace(options, trust_region=radius * options.trust_region)
        progress.begin()
        overload = COARSE_OVERLOAD if self.options.refine == "auto" else OVERLOAD
        solve = partial(
            solve_from_guess,
            system,
            options,
            guess,
            progress,
            coarse=True,
            overload=overload,
        )
        with progress.judged(self.judge.enough):
            return guarded(system.problem, options, progress, guess.name, solve)

    def _touches(self, attempt: Attempt) -> bool:
        """Whether links of an arm that is alone are known to touch in a motion."""
        alone = self.system.alone
        return alone and links_touch(self.system.problem, attempt.trajectory)

    def _parted(self, attempt: Attempt, guess: Guess) -> Attempt | None:
        """A motion in which links touch, gone on with with rows for them.

        On the coarse grid: the fine one begins with links that are clear then. None if
        that leads nowhere.
        """
        former = self._former(attempt, guess)
        apart = self._coarse(self.system, former, RADIUS)
        if apart is None or apart.violation > NEARLY:
            return None
        return apart.after(attempt)

    def _former(self, attempt: Attempt, guess: Guess) -> WarmStart:
        """What a guess has led to, to go on from."""
        former = warm_start(self.system, attempt.trajectory)
        return replace(former, name=attempt.name, blocked=guess.blocked)

    # -- on the grid that is asked for -------------------------------------------------

    def finished(self, rough: Rough) -> Attempt | None:
        """Go on from a coarse motion on the grid that is asked for."""
        system, fine, progress = self.system, self.grids.fine, self.progress
        judge = self.judge
        early = self._secured(rough)
        progress.begin()
        former = rough.attempt
        # A finer motion would touch, too.
        progress.links_touched = rough.touches or former.apart
        guess = self._former(former, rough.guess)
        solve = partial(solve_and_verify, system, fine, guess, progress)
        with progress.judged(judge.of_finish(rough)):
            attempt = guarded(system.problem, fine, progress, former.name, solve)
        if progress.let_go and judge.ends:
            return None
        if attempt is None or progress.let_go:
            return early if early is not None and early.found else None
        attempt = attempt.after(former)
        self.stopped = attempt.status in STOPPED
        if self.stopped and not attempt.found and progress.best == np.inf:
            early = early or self._replayed(rough)
        if early is not None and early.found and not attempt.found:
            status, history = attempt.status, attempt.history
            attempt = replace(early, status=status, history=history)
        if attempt.found:
            self._gains.append(rough.duration / attempt.duration - 1.0)
            judge.ends.append(shape_of(system, attempt.trajectory))
        progress.best = min(progress.best, attempt.duration)
        logger.info("coarse %.6g s, fine %.6g s", rough.duration, attempt.duration)
        return attempt

    def _secured(self, rough: Rough) -> Attempt | None:
        """The coarse motion, replayed, where there may be no time to go on from it.

        A plan that takes long is known by what it took so far, or by links that have to
        be parted, which takes several times as long; without a limit for the time there
        is enough of it. None where that is not so.
        """
        progress = self.progress
        long = progress.share_used >= LATE
        apart = self.system.alone and (rough.touches or rough.attempt.apart)
        long = long or (apart and progress.left is not None)
        if not long or progress.best < np.inf:
            return None
        early = self._replayed(rough)
        if early.verification is not None:
            progress.replayed(early.verification.seconds)
        return early

    def saved(self) -> Iterator[Attempt]:
        """What there is when it is time to stop: the best coarse motion, replayed."""
        known = self.judge.known
        if not known or self.progress.best < np.inf:
            return
        last = known[-1].attempt
        ended = last.status if last.status in STOPPED else Status.TIME_LIMIT
        best = min(known, key=lambda one: (one.attempt.duration, one.duration))
        yield replace(self._replayed(best), status=ended)

    def _replayed(self, rough: Rough) -> Attempt:
        """A coarse motion, as slow as it has to be for its replay to be all right.

        Where links touch in it that is none: then what it began with is slowed down.
        """
        program, iterate, _ = rough.kept
        attempt = rough.attempt
        if attempt.verification is not None and attempt.found:
            return attempt
        factors: tuple[float, ...] = TIME_SCALINGS
        if rough.touches:
            program, iterate, _ = slower = slowed_down(rough.begun) or rough.kept
            attempt = replace(attempt, feasible=slower is not rough.kept)
            factors = (1.0,)
        with self.progress.saving(), contextlib.suppress(Stop):
            for factor in factors:
                motion = program.trajectory(program.stretch(iterate.z, factor))
                slow = replace(attempt, trajectory=motion, layout=None)
                attempt = slow.verified(self.system.problem, self.options)
                if attempt.found:
                    break
            return attempt
        return replace(attempt, unconfirmed=True)  # there was no time for all of it

    def descents(self, guesses: Iterable[Guess], wanted: int) -> Iterator[Attempt]:
        """The first motions of a plan.

        Args:
            guesses: The guesses; of those that are wanted the best is finished, and of
                further ones the first that leads to a motion.
            wanted: How many of them are compared.
        """
        source = iter(guesses)
        for guess in itertools.islice(source, wanted):
            best = min((one.duration for one in self.judge.known), default=np.inf)
            if guess.timed and guess.duration > TOO_SLOW * best:
                continue
            self.rough(guess)
            if self.stopped:
                break
        tried: list[Rough] = []
        while not self.stopped:
            left = [rough for rough in self.judge.known if rough not in tried]
            for rough in sorted(left, key=lambda one: one.duration):
                tried.append(rough)
                attempt = self.finished(rough)
                if attempt is not None:
                    yield attempt
                if self.stopped or (attempt is not None and attempt.found):
                    return
            further = next(source, None)
            if further is None:
                return
            self.rough(further)
        yield from self.saved()

    def know(self, attempt: Attempt) -> None:
        """Have a motion that was found elsewhere stand for what coarse grids cost."""
        rough = self.rough(Guess.of_motion(attempt.name, attempt.trajectory))
        if rough is not None:
            self._gains.append(rough.duration / attempt.duration - 1.0)

    def compare(self) -> None:
        """Have starts promise only what is less than the coarse motions so far.

        The loss of the coarse grid is that of the motions that were finished then.
        """
        if self._gains:
            self.loss = min(self.loss, max(0.0, *self._gains))

    def probes(self, guesses: Iterable[Guess], patience: int) -> Iterator[Attempt]:
        """Try further guesses, and finish those that promise a faster motion.

        Args:
            guesses: The guesses.
            patience: After so many of them in a row that promise nothing it is enough.
        """
        found: list[Rough] = []
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
            attempt = self.finished(rough)
            if attempt is not None:
                yield attempt
            if self.stopped:
                return

    def _promises(self, rough: Rough) -> bool:
        """Whether a motion may be faster than the best one, once it is finished."""
        promised = rough.duration / (1.0 + self.loss)
        return promised < (1.0 - PROMISE) * self.progress.best
