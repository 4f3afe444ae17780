"""Search on coarse grids: cheap starts, the best of which are finished.

A descent on a few intervals takes a fraction of the time, and is less apt to end in a
poor local optimum than one on the grid that is asked for: obstacles and torque limits
bind at fewer instants. So starts are compared by their motions there, and those that
lead to the same motion as others before, or to slower ones, are dropped.

Further starts are tried if the incumbent is far above the lower bound: most motions
that speed limits rule are within a per cent of it, and need no other start. Every
decision depends on the candidates before it alone, so that a search of more starts
finds the motions of one of fewer starts, and then others.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tominpmp.arrays import Array
from tominpmp.constraints.friction import EFFORT_TOLERANCE
from tominpmp.initial_guess.bumps import bumps
from tominpmp.initial_guess.guess import SAMPLED, Guess
from tominpmp.motion.curves import states
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Control, Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.descent import (
    MANY_INTERVALS,
    descend,
    descent_work,
    guess_of,
    torques_rule,
)
from tominpmp.planner.plan_state import PlanState
from tominpmp.planner.torque_starts import (
    FEW_JOINTS,
    random_torque_starts,
    torques_may_lead,
)
from tominpmp.planner.work import NEARLY, Schedule, Work
from tominpmp.solvers.loop import Loop, Rule
from tominpmp.status import Status
from tominpmp.transcription.problem_functions import ProblemFunctions

logger = logging.getLogger(__name__)

# Intervals of a coarse grid.
INTERVALS = 16
# How exactly a coarse motion is found, and in how many iterations.
TOLERANCE, ITERATIONS = 2e-3, 30
# Excess of torques between the rows of coarse grids that is tolerated, where the asked
# grid removes the rest of it; 3e-2 would be too much to slow down. Exact switching
# begins with the motion of the coarse grid.
COARSE_EFFORT_TOLERANCE = 1e-2
# Trust region for finishing a coarse motion, as a share of the usual one.
RADIUS = 0.5
# Most intervals to finish a motion with that is limited by torques, if its grid may be
# refined, and most joints times intervals: a program of thirty joints takes a second.
TORQUE_INTERVALS, TORQUE_VARIABLES = 80, 640
# Discretisation loss of a coarse grid, as a share of T, of motions that torques limit
# and of those that speeds limit.
TORQUE_LOSS, SPEED_LOSS = 0.06, 0.01
# A start is dropped that is not nearly feasible this many iterations after rows have
# joined its program last, or whose trust region is smaller than STUCK then.
PATIENCE = 12
STUCK = 0.02
# Extrapolated gain of all further iterations, in multiples of the last gain.
LEFT = 3.0
# Least gain over the incumbent that a coarse motion promises, as a share of T.
PROMISE = 0.003
# A timed guess this much slower than a motion that was found is not worth its time.
TOO_SLOW = 1.4
# Instants at which motions are compared, and how near to each other the same ones are
# [rad, or shares of the reach].
SAMPLES = 12
SAME = 0.05
# The search ends where the gap of the incumbent to the lower bound is at most this.
GAP = 0.03
# Arms of at most FEW_JOINTS joints are searched on in free space, too: they may swing,
# or turn their elbow over. Least number of detours that are tried.
DETOURS = 6
# Arms of more joints, up to MOST_JOINTS, are searched on where T is more than FAR_ABOVE
# times the lower bound: of 70 random goals (speeds times four) five were, and three of
# them were 1 to 4 % longer than need be. A start of a whole robot takes seconds.
FAR_ABOVE, MOST_JOINTS = 2.0, 10
# The same among obstacles, where each way round them is another optimum.
ABOVE_AMONG_OBSTACLES = 1.2
# A descent among obstacles on the requested grid is stopped after this many iterations
# unless it is nearly feasible and its gap to the lower bound is at most GAP; and at any
# iteration where the gap exceeds FAR_ASTRAY. Coarse grids follow.
DIRECT, FAR_ASTRAY = 8, 0.1
# Stop rule of probes: number of consecutive starts without promise, for arms of few
# joints, and of many.
IN_VAIN, MANY_IN_VAIN = 4, 8
# Stop rule of further paths among obstacles, and for arms of few joints, whose bounds
# say little: of 42 problems of a planar arm 7 ended 0.2 to 45 % faster by the 7th to
# 14th path, two 0.1 and 0.2 % slower, in 1.1 times the time; 28 found nothing more.
# More of them where obstacles move, as a path can be followed with different timing.
# For a Panda under a table a second path without promise leads to a faster motion in
# one of 16 problems (by 13 %), and takes a fifth of their time; for a Fetch a tenth,
# without a gain in 19.
PATHS_IN_VAIN, PATHS_IN_VAIN_WHILE_MOVING = 1, 6
# Further paths at most: each that promises a gain allows for others.
MOST_PATHS = 14
# Random torques that are tried where a motion has to swing.
SHOTS = 3


def coarse_grids_apply(system: ProblemFunctions, options: Options) -> bool:
    """Whether coarse grids are for a problem, and for these options."""
    return (
        options.method == "inverse"
        and options.objective == "time"
        and options.intervals >= MANY_INTERVALS
        and not system.parts
    )


class CachedGuesses:
    """Guesses that can be gone through again.

    Args:
        guesses: The guesses; one is made when it is first asked for.
    """

    def __init__(self, guesses: Iterator[Guess]) -> None:
        self._guesses = guesses

    def since(self, number: int) -> Iterator[Guess]:
        """The guesses from a number on, counted from 0."""
        self._guesses, again = itertools.tee(self._guesses)
        return itertools.islice(again, number, None)


def search(
    system: ProblemFunctions, state: PlanState, guesses: CachedGuesses, compared: int
) -> Schedule[None]:
    """Search for the best motion of a problem with one goal.

    Args:
        system: The functions of the problem.
        state: The plan.
        guesses: Guesses, the most promising first.
        compared: Number of them that are compared before one of them is finished.
    """
    first_ones = list(itertools.islice(guesses.since(0), compared))
    first = next((guess for guess in first_ones if guess.timed), first_ones[0])
    torques = torques_rule(system, first)
    coarse = CoarseSearch(system, state.options, state, torques=torques)
    if system.final_configuration is not None and not torques:
        # Where speed limits rule and little is in the way, a descent on the grid that
        # is asked for takes a few iterations, and ends near the lower bound.
        stop = None if system.in_free_space else partial(_leads_astray, state, system)
        yield descent_work(system, state.options, first, state, stop)
        if state.best_duration < np.inf and (
            system.in_free_space or not coarse.promising
        ):
            return
    yield from coarse.descents(_paths_first(system, guesses, compared), compared)
    if state.options.effort == "quick" or not coarse.promising:
        return
    coarse.calibrate_loss()
    further = _further(coarse, guesses, first, compared)
    yield from coarse.probes(further, coarse.patience)
    if torques_may_lead(system) and not first.timed:
        # Weights that cannot be held on the way have to be swung over it.
        yield from random_torque_starts(system, state, SHOTS)


def _paths_first(
    system: ProblemFunctions, guesses: CachedGuesses, compared: int
) -> Iterator[Guess]:
    """The guesses, a sampled path before the one straight line among obstacles.

    Where the straight line is far from feasible, a path leads to a motion as good in
    half the programs.
    """
    first, *second = itertools.islice(guesses.since(0), 2)
    swap = compared == 1 and not system.in_free_space
    if not (swap and second and second[0].name == SAMPLED):
        return guesses.since(0)
    return itertools.chain(second, [first], guesses.since(2))


def _leads_astray(
    state: PlanState, system: ProblemFunctions, loop: Loop
) -> Status | None:
    """Stop rule among obstacles: the gap to the lower bound stays too large."""
    record = loop.history[-1]
    bound = state.lower_bound(system.problem).T
    above = record.duration / max(bound, 1e-12) - 1.0
    early = len(state.records) < DIRECT
    near = early or (above <= GAP and record.violation <= NEARLY)
    return None if near and above <= FAR_ASTRAY else Status.ITERATION_LIMIT


def _further(
    coarse: CoarseSearch, guesses: CachedGuesses, first: Guess, compared: int
) -> Iterator[Guess]:
    """Guesses that are tried beyond the first descents."""
    system = coarse.system
    if not system.in_free_space:
        return itertools.islice(guesses.since(compared), MOST_PATHS)
    rng = np.random.default_rng(coarse.options.seed)
    detours = bumps(system, first, rng, from_base=coarse.many_joints)
    return itertools.islice(detours, max(2 * system.n, DETOURS))


def _shape_of(system: ProblemFunctions, motion: Trajectory) -> Array:
    """Configurations at even shares of the duration, scaled, shape (SAMPLES, n)."""
    times = np.linspace(0.0, 1.0, SAMPLES) * motion.duration
    q, _, _ = states(motion.t, motion.q, motion.v, motion.a, times)
    return np.asarray(q / system.step_scale)


@dataclass(frozen=True, eq=False)
class CoarseMotion:
    """A motion on a coarse grid.

    Attributes:
        candidate: Its candidate.
        guess: The guess it began with.
        shape: Its shape.
    """

    candidate: Candidate
    guess: Guess
    shape: Array

    @property
    def duration(self) -> float:
        """T on the coarse grid [s]; infinite if it is far from a motion."""
        near = self.candidate.violation <= NEARLY
        return self.candidate.trajectory.duration if near else np.inf


class CoarseSearch:
    """Starts on coarse grids, and the descents that finish them.

    Where torques rule, even intervals lose least; where speeds and obstacles do, short
    ones at both ends. A weight on the variation of torques leads to better optima on
    the coarse grid; on the fine one it costs 0.1 % of T. If the grid may follow the
    motion anyway, torques get twice the intervals at once: that ends 0.1 to 0.5 % lower
    (six goals).

    Args:
        system: The problem.
        options: Options of the plan.
        state: The plan.
        torques: Whether torques rule the motion.

    Attributes:
        known: Motions on coarse grids, all different.
        loss: Loss of the coarse grid, as a share of T.
    """

    def __init__(
        self,
        system: ProblemFunctions,
        options: Options,
        state: PlanState,
        *,
        torques: bool,
    ) -> None:
        if options.control == "auto":
            control: Control = "linear" if torques else "constant"
            options = replace(options, control=control)
        self.system, self.options, self.state = system, options, state
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
        self._tried: list[Guess] = []
        self._gains: list[float] = []

    @property
    def many_joints(self) -> bool:
        """Whether the arm has more than FEW_JOINTS joints."""
        return self.system.n > FEW_JOINTS

    @property
    def patience(self) -> int:
        """Number of consecutive starts without promise that end the search."""
        if self.system.in_free_space:
            return MANY_IN_VAIN if self.many_joints else IN_VAIN
        if not self.many_joints:
            return MOST_PATHS
        moving = self.system.problem.scene.moving
        return PATHS_IN_VAIN_WHILE_MOVING if moving else PATHS_IN_VAIN

    @property
    def promising(self) -> bool:
        """Whether there may be a motion that is a good deal faster."""
        system, best = self.system, self.state.best_duration
        if system.final_configuration is None or system.n > MOST_JOINTS:
            return False
        if best == np.inf:
            # Among obstacles all guesses were tried.
            return system.in_free_space and not self.many_joints
        above = 1.0 + GAP
        if self.many_joints:
            above = FAR_ABOVE if system.in_free_space else ABOVE_AMONG_OBSTACLES
        return best > above * self.state.lower_bound(system.problem).T

    # -- on the coarse grid ------------------------------------------------------------

    def solve_coarse(self, guess: Guess) -> Schedule[CoarseMotion | None]:
        """Improve a guess on the coarse grid; None if it leads nowhere that is new."""
        self._tried.append(guess)
        make = partial(
            descend,
            self.coarse,
            guess,
            self.state,
            self._drop_early(),
            effort_tolerance=COARSE_EFFORT_TOLERANCE
            if self.options.refine == "auto"
            else EFFORT_TOLERANCE,
        )
        candidate = yield Work(self.system, guess.name, make, replay=False)
        if candidate is None:
            return None
        shape = _shape_of(self.system, candidate.trajectory)
        rough = CoarseMotion(candidate, guess, shape)
        if rough.duration == np.inf or self._knows(shape):
            return None
        self.known.append(rough)
        return rough

    def _drop_early(self) -> Rule:
        """Rule that drops a start which leads to no motion that is new or faster."""
        rows = joined = 0

        def rule(loop: Loop) -> Status | None:
            nonlocal rows, joined
            count, record = len(loop.history), loop.history[-1]
            if loop.program.rows.size != rows:
                joined, rows = count, loop.program.rows.size
            if record.violation > NEARLY:
                over = count - joined >= PATIENCE or record.radius < STUCK
                return loop.drop() if over else None
            known = bool(self.known) and self._knows(self._present_shape(loop))
            return loop.drop() if known or self._outdone(loop) else None

        return rule

    def _present_shape(self, loop: Loop) -> Array:
        """Shape of the motion that an iteration has come to."""
        z = (loop.best or loop.state).z
        return _shape_of(self.system, loop.program.trajectory(z))

    def _knows(self, shape: Array) -> bool:
        return any(np.max(np.abs(shape - one.shape)) < SAME for one in self.known)

    def _outdone(self, loop: Loop) -> bool:
        """Whether a start will end no faster than one that went before.

        Iterations gain less and less: LEFT times the last gain is the most to come.
        """
        if self.system.final_configuration is not None or not self.system.in_free_space:
            return False
        best = min((one.duration for one in self.known), default=np.inf)
        if best == np.inf or len(loop.history) < 2:
            return False
        before, now = (record.duration for record in loop.history[-2:])
        left = LEFT * max(before - now, 0.0)
        return now - left > (1.0 - PROMISE) * best

    # -- on the grid that is asked for -------------------------------------------------

    def finish(self, rough: CoarseMotion) -> Schedule[Candidate | None]:
        """Go on from a coarse motion on the grid that is asked for."""
        system, former = self.system, rough.candidate
        guess = replace(guess_of(system, former), blocked=rough.guess.blocked)
        candidate = yield descent_work(
            system, self.fine, guess, self.state, follows=former
        )
        if candidate is None:
            return None
        if candidate.found:
            self._gains.append(rough.duration / candidate.duration - 1.0)
        T = candidate.duration
        logger.info("coarse %.6g s, fine %.6g s", rough.duration, T)
        return candidate

    # -- comparisons -------------------------------------------------------------------

    def descents(self, guesses: Iterator[Guess], wanted: int) -> Schedule[None]:
        """The first motions of a plan.

        Args:
            guesses: The guesses; of those that are wanted the best is finished, and of
                further ones the first that leads to a motion.
            wanted: How many of them are compared.
        """
        for guess in itertools.islice(guesses, wanted):
            best = min((one.duration for one in self.known), default=np.inf)
            if not (guess.timed and guess.duration > TOO_SLOW * best):
                yield from self.solve_coarse(guess)
        tried: list[CoarseMotion] = []
        while True:
            left = [rough for rough in self.known if rough not in tried]
            for rough in sorted(left, key=lambda one: one.duration):
                tried.append(rough)
                candidate = yield from self.finish(rough)
                if candidate is not None and candidate.found:
                    return
            further = next(guesses, None)
            if further is None:
                return
            yield from self.solve_coarse(further)

    def calibrate_loss(self) -> None:
        """Calibrate the loss of the coarse grid on the motions finished so far.

        Further starts then promise a gain only if their coarse motion is faster. The
        loss is no guide for small arms in free space, which may swing.
        """
        calibrated = self.many_joints or not self.system.in_free_space
        if calibrated and self._gains:
            self.loss = min(self.loss, max(0.0, min(self._gains)))

    def probes(
        self,
        guesses: Iterable[Guess],
        patience: float = np.inf,
        prepared: Callable[[Guess], Schedule[Guess]] | None = None,
    ) -> Schedule[None]:
        """Try further guesses, and finish those that promise a faster motion.

        Args:
            guesses: The guesses.
            patience: Stop rule: number of consecutive guesses without promise.
            prepared: Coroutine that transforms each guess before it is tried.
        """
        found: list[CoarseMotion] = []
        in_vain, best = 0, np.inf
        for guess in guesses:
            if prepared is not None:
                guess = yield from prepared(guess)
            if guess in self._tried:
                continue
            rough = None
            if not (guess.timed and guess.duration > TOO_SLOW * self._least_guess):
                rough = yield from self.solve_coarse(guess)
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
            yield from self.finish(rough)
            self.calibrate_loss()

    @property
    def _least_guess(self) -> float:
        """Least duration of the timed guesses that have led to motions [s]."""
        timed = (one.guess for one in self.known if one.guess.timed)
        return min((guess.duration for guess in timed), default=np.inf)

    def _promises(self, rough: CoarseMotion) -> bool:
        """Whether a motion may be faster than the best one, once it is finished."""
        promised = rough.duration / (1.0 + self.loss)
        return promised < (1.0 - PROMISE) * self.state.best_duration
