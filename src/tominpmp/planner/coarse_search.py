"""Search for one goal: starts are compared on coarse grids, and the best are finished.

Where speed limits rule, a single descent on the requested grid mostly ends within a per
cent of the lower bound, and no other start is needed. Elsewhere starts are compared by
descents on few intervals. Such a descent takes a fraction of the time, and is less apt
to end in a poor local optimum, as obstacles and torque limits are active at fewer
instants. Starts that lead to a slower or a known motion are dropped.

Further starts follow if the incumbent is far above the lower bound. Every decision
depends only on the candidates before it, so that a search with more starts finds the
motions of a search with fewer starts first, and then others.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.initial_guess.guess import SAMPLED, CachedGuesses, Guess, bumps
from tominpmp.initial_guess.path import PLACES
from tominpmp.initial_guess.rrt import NEAR
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.automatic_options import PROMISE, WARM_RADIUS
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import (
    MANY_INTERVALS,
    descend,
    descent_work,
    guess_of,
    torque_limited,
)
from tominpmp.planner.plan_state import PlanState, start_key
from tominpmp.planner.torque_starts import FEW_JOINTS, torque_starts, torques_may_lead
from tominpmp.planner.work import Schedule, Work
from tominpmp.solvers.loop import Loop
from tominpmp.solvers.objective import RESTORABLE
from tominpmp.status import Status
from tominpmp.transcription.problem_functions import ProblemFunctions

# Intervals of a coarse grid, whose nodes are nodes of the default grid of 40 intervals.
INTERVALS = 16
# Tolerance of descents on a coarse grid.
TOLERANCE = 2e-3
# Most intervals on which a motion ruled by torques is finished, if its grid may be
# refined.
TORQUE_INTERVALS = 80
# Discretisation loss of a coarse grid, as a share of T, that is assumed for arms of at
# most FEW_JOINTS joints in free space: without it, two of five pairs of rods miss their
# global optimum. For other motions it gains nothing (23 problems).
LOSS = 0.06
# A guess is too slow if it is slower by this factor than the guess of a known motion:
# where obstacles move, descents from all guesses take half as many programs more.
# Compared with known motions, plans of a Fetch take 0.7 of the time, and six of 40
# motions are 5 to 26 % slower.
TOO_SLOW = 1.4
# The search ends where the gap of the incumbent to the lower bound is at most this. A
# warm start is followed by a search unless its motion is faster than the first guess by
# more than this.
GAP = 0.03
# For arms of at most FEW_JOINTS joints the search continues in free space, too: they
# may swing, or flip their elbow. For arms of more joints, up to MOST_JOINTS, it
# continues there if T is over FAR_ABOVE times the lower bound: of 70 random goals
# (speeds times four) this held for five, and three of these were 1 to 4 % longer than
# necessary. With more joints, as of a humanoid, each start takes seconds.
FAR_ABOVE, MOST_JOINTS = 2.0, 10
# A descent among obstacles on the requested grid is stopped at any iteration where the
# gap to the lower bound exceeds this. Coarse grids follow.
LARGE_GAP = 0.1
# Stop rule of probes: number of consecutive starts without a gain, in free space and
# where obstacles move, as a path can be followed with different timing.
FAILURES = 4
# Among obstacles at rest a single path without a gain ends the search, or a second one
# where T is above the lower bound by more than this: of 40 problems of a Fetch, two
# became 9 and 24 % faster, in 1.06 times the time; of 21 problems of a Panda none, in
# 1.09 times. As many paths as T / bound gain more, in 1.5 times the time.
WIDE_GAP = 0.5
# Most further starts, as each one with a gain resets the stop rule. For arms of few
# joints among obstacles, whose lower bounds say little, all of them are tried: of 42
# problems of a planar arm 7 ended 0.2 to 45 % faster by the 7th to 14th path, two 0.1
# and 0.2 % slower, in 1.1 times the time; 28 found nothing more.
MOST_PATHS = 14


def coarse_grids_apply(system: ProblemFunctions, options: Options) -> bool:
    """Whether the search on coarse grids applies to a problem and its options."""
    return (
        options.method == "inverse"
        and options.objective == "time"
        and options.intervals >= MANY_INTERVALS
        and not system.parts
    )


def search(
    system: ProblemFunctions, state: PlanState, guesses: CachedGuesses, compared: int
) -> Schedule[None]:
    """Search for the best motion of a problem with one goal.

    Args:
        system: Functions of the problem.
        state: The plan.
        guesses: Guesses, the most promising first.
        compared: Number of guesses that are compared before the best one is finished.
    """
    head = list(itertools.islice(guesses.since(0), compared))
    first = next((guess for guess in head if guess.timed), head[0])
    torques = torque_limited(system, first)
    coarse = CoarseSearch(system, state, torques=torques)
    if system.final_configuration is not None and not torques:
        # Where speed limits rule and there are few obstacles, a descent on the
        # requested grid takes a few iterations, and ends near the lower bound.
        stop = None if system.in_free_space else partial(_gap_rule, state, system)
        yield descent_work(system, state.options, first, state, stop)
        if state.best_duration < np.inf and (
            system.in_free_space or not coarse.promising
        ):
            return
    yield from coarse.descents(_paths_first(system, guesses, compared), compared)
    if state.options.effort == "quick" or not coarse.promising:
        return
    further = _further_guesses(coarse, guesses, first, compared)
    yield from coarse.probes(further, coarse.patience)
    if torques_may_lead(system) and not first.timed:
        # An arm that is too weak to hold its weight along the path may have to swing.
        yield from torque_starts(system, state)


def _paths_first(
    system: ProblemFunctions, guesses: CachedGuesses, compared: int
) -> Iterator[Guess]:
    """The guesses; among obstacles a sampled path comes before a single straight line.

    If the straight line is far from feasible, a sampled path leads to an equally good
    motion in half as many programs.
    """
    first, *second = itertools.islice(guesses.since(0), 2)
    swap = compared == 1 and not system.in_free_space
    if not (swap and second and second[0].name == SAMPLED):
        return guesses.since(0)
    return itertools.chain(second, [first], guesses.since(2))


def _gap_rule(state: PlanState, system: ProblemFunctions, loop: Loop) -> Status | None:
    """Stop rule among obstacles: an iterate is too far above the lower bound."""
    largest = (1.0 + LARGE_GAP) * state.lower_bound(system.problem).T
    return Status.ITERATION_LIMIT if loop.history[-1].duration > largest else None


def _further_guesses(
    coarse: CoarseSearch, guesses: CachedGuesses, first: Guess, compared: int
) -> Iterator[Guess]:
    """Guesses after the first descents: paths, or detours from the first guess."""
    system = coarse.system
    if not system.in_free_space:
        return itertools.islice(guesses.since(compared), MOST_PATHS)
    rng = np.random.default_rng(coarse.state.options.seed)
    detours = bumps(system, first, rng, from_base=coarse.many_joints)
    return itertools.islice(detours, MOST_PATHS)


def _shape_of(system: ProblemFunctions, motion: Trajectory) -> Array:
    """Scaled configurations at evenly spaced instants, shape (PLACES, n)."""
    times = np.linspace(0.0, 1.0, PLACES) * motion.duration
    return np.asarray(motion(times, 0) / system.step_scale)


@dataclass(frozen=True, eq=False)
class CoarseMotion:
    """A motion on a coarse grid.

    Attributes:
        candidate: The candidate.
        guess: Its guess.
        shape: Scaled configurations for comparisons, shape (PLACES, n).
    """

    candidate: Candidate
    guess: Guess
    shape: Array

    @property
    def duration(self) -> float:
        """T on the coarse grid [s]; infinite unless it is nearly feasible."""
        near = self.candidate.violation <= RESTORABLE
        return self.candidate.trajectory.duration if near else np.inf


class CoarseSearch:
    """Starts on coarse grids, and the descents on the requested grid that finish them.

    Where torque limits rule, a uniform grid loses least; where speed limits or
    obstacles do, a grid with short intervals at both ends. A weight on the total
    variation of the torques leads to better optima on the coarse grid; on the fine grid
    it costs 0.1 % of T. If the grid will be refined anyway, motions in free space that
    torques rule are finished on twice as many intervals: they end 0.1 to 0.5 % faster
    (six goals). With limits of jerk or torque rate, twice as many intervals gain
    nothing (46 goals), and the interior-point method fails on their short ends.

    Args:
        system: Functions of the problem.
        state: The plan.
        torques: Whether torque limits rule the motion, rather than speed limits.

    Attributes:
        known: Motions on coarse grids, all different.
    """

    def __init__(
        self, system: ProblemFunctions, state: PlanState, *, torques: bool
    ) -> None:
        options = state.options
        if options.control == "auto":
            options = replace(options, control="linear" if torques else "constant")
        self.system, self.state = system, state
        self.coarse = replace(
            options,
            intervals=INTERVALS,
            refine=None,
            tolerance=max(options.tolerance, TOLERANCE),
        )
        self.fine = replace(options, trust_region=WARM_RADIUS * options.trust_region)
        if torques:
            self.fine = replace(self.fine, smoothing=options.smoothing or 0.0)
        if torques and system.in_free_space:
            self.coarse = replace(self.coarse, grid="uniform")
            jumps = options.refine == "auto" and system.sudden
            if jumps and system.n <= MOST_JOINTS:
                finer = min(2 * options.intervals, TORQUE_INTERVALS)
                finer = max(options.intervals, finer)
                self.fine = replace(self.fine, intervals=finer)
        self.known: list[CoarseMotion] = []

    @property
    def many_joints(self) -> bool:
        """Whether the arm has more than FEW_JOINTS joints."""
        return self.system.n > FEW_JOINTS

    @property
    def patience(self) -> int:
        """Number of consecutive probes without a gain that end the search."""
        if self.system.in_free_space:
            return FAILURES
        if not self.many_joints:
            return MOST_PATHS
        if self.system.problem.scene.moving:
            return FAILURES
        return 2 if self.state.exceeds_bound(1.0 + WIDE_GAP, self.system.problem) else 1

    @property
    def decided(self) -> bool:
        """Whether every faster motion counts as the same as a known motion.

        At its speed limit no joint gets further than NEAR within the known duration.
        """
        fastest = min((rough.duration for rough in self.known), default=np.inf)
        most = fastest * self.system.problem.robot.limits.velocity
        return bool(np.all(most < NEAR * self.system.step_scale))

    @property
    def promising(self) -> bool:
        """Whether a much faster motion than the incumbent may exist."""
        system, best = self.system, self.state.best_duration
        unfit = system.final_configuration is None or system.n > MOST_JOINTS
        if unfit or self.decided:
            return False
        if best == np.inf:
            # Among obstacles all guesses have been tried.
            return system.in_free_space and not self.many_joints
        far = self.many_joints and system.in_free_space
        above = FAR_ABOVE if far else 1.0 + GAP
        return self.state.exceeds_bound(above, system.problem)

    # -- on the coarse grid ------------------------------------------------------------

    def untried(self, guess: Guess) -> bool:
        """Whether no search of the plan for this goal has descended from a guess."""
        return start_key(self.system.problem, guess.t, guess.q) not in self.state.tried

    def solve_coarse(self, guess: Guess) -> Schedule[CoarseMotion | None]:
        """Descend on the coarse grid; None without a new motion.

        A motion is new if it is nearly feasible and differs from all known ones; it is
        then known itself.
        """
        self.state.tried.add(start_key(self.system.problem, guess.t, guess.q))
        make = partial(descend, self.coarse, guess, self.state, self._drop_early)
        # Links that touch on one motion mostly touch on others.
        touch = any(item.clearance_rows for item in self.state.candidates)
        candidate = yield Work(
            self.system, make, self_collision_rows=touch, replay=False
        )
        if candidate is None:
            return None
        shape = _shape_of(self.system, candidate.trajectory)
        rough = CoarseMotion(candidate, guess, shape)
        if rough.duration == np.inf or self._is_known(shape):
            return None
        self.known.append(rough)
        return rough

    def _drop_early(self, loop: Loop) -> Status | None:
        """Stop rule that drops a start whose motion is known, or slow."""
        if not self.known or loop.history[-1].violation > RESTORABLE:
            return None
        motion = loop.program.trajectory((loop.best or loop.state).z)
        known = self._is_known(_shape_of(self.system, motion))
        return loop.drop() if known or self._is_slower(loop) else None

    def _is_known(self, shape: Array) -> bool:
        return any(np.max(np.abs(shape - rough.shape)) < NEAR for rough in self.known)

    def _is_slower(self, loop: Loop) -> bool:
        """Whether a start will end slower than the best motion on the coarse grid.

        As iterations gain less and less, all remaining ones are taken to gain as much
        as the last one.
        """
        if self.system.final_configuration is not None or not self.system.in_free_space:
            return False
        if len(loop.history) < 2:
            return False
        best = min(rough.duration for rough in self.known)
        before, now = (record.duration for record in loop.history[-2:])
        return now - max(before - now, 0.0) > (1.0 - PROMISE) * best

    # -- on the requested grid ---------------------------------------------------------

    def finish(self, rough: CoarseMotion) -> Schedule[Candidate | None]:
        """Improve a coarse motion on the requested grid."""
        system, former = self.system, rough.candidate
        work = descent_work(system, self.fine, guess_of(system, former), self.state)
        return (yield replace(work, follows=former))

    # -- comparisons -------------------------------------------------------------------

    def descents(self, guesses: Iterator[Guess], wanted: int) -> Schedule[None]:
        """The first descents of a plan, until one of them is confirmed by its replay.

        Args:
            guesses: The guesses. The first ``wanted`` ones are compared on the coarse
                grid and finished in the order of their durations; further guesses
                follow one by one.
            wanted: Number of guesses that are compared.
        """
        for guess in itertools.islice(guesses, wanted):
            if not self._is_too_slow(guess):
                yield from self.solve_coarse(guess)
        found = sorted(self.known, key=lambda rough: rough.duration)
        while True:
            for rough in found:
                candidate = yield from self.finish(rough)
                if candidate is not None and candidate.confirmed:
                    return
            further = None if self.decided else next(guesses, None)
            if further is None:
                return
            other = yield from self.solve_coarse(further)
            found = [] if other is None else [other]

    def probes(
        self, guesses: Iterable[Guess], patience: float = np.inf
    ) -> Schedule[None]:
        """Descend from further guesses, and finish each motion that predicts a gain.

        Args:
            guesses: The guesses.
            patience: Stop rule: number of consecutive guesses without a gain.
        """
        failures = 0
        for guess in filter(self.untried, guesses):
            slow = self._is_too_slow(guess)
            rough = None if slow else (yield from self.solve_coarse(guess))
            failures, before = failures + 1, self.state.best_duration
            if rough is not None and self._promises(rough):
                yield from self.finish(rough)
            if self.state.best_duration < (1.0 - PROMISE) * before:
                failures = 0
            if failures >= patience:
                return

    def _is_too_slow(self, guess: Guess) -> bool:
        """Whether a guess is much slower than that of a known motion."""
        timed = [rough.guess.duration for rough in self.known if rough.guess.timed]
        return guess.timed and guess.duration > TOO_SLOW * min(timed, default=np.inf)

    def _promises(self, rough: CoarseMotion) -> bool:
        """Whether a coarse motion predicts a gain over the incumbent once finished."""
        swings = self.system.in_free_space and not self.many_joints
        promised = rough.duration / (1.0 + LOSS) if swings else rough.duration
        return promised < (1.0 - PROMISE) * self.state.best_duration
