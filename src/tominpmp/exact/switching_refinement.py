"""Switching refinement: from a motion on a grid to exact switching times.

The same problem often has several locally time-optimal motions, which differ by the
order of their switches and are not connected by small changes. Other initial guesses
lead to them (multi-start): an optimisation of torques on a coarse grid turns each guess
into a motion near a local optimum, whose arcs are then optimised. Approximate arcs of a
motion are read from its torques and speeds (:func:`arcs_of`).
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exact.structure import Arcs, read_arcs
from tominpmp.exact.switching_times import OptimisedArcs, refine_arcs, sharpen
from tominpmp.initial_guess.guess import Guess, bumps, straight_guess
from tominpmp.initial_guess.inverse_kinematics import Target
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.planner.candidate import Candidate
from tominpmp.planner.plan_state import PlanState
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.loop import Loop, first_of, solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.status import Status
from tominpmp.stopping import EVALUATIONS, Budget
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

logger = logging.getLogger(__name__)

# Largest number of unknowns of a refinement, whose quadratic programs are dense.
MOST_UNKNOWNS = 160
# Numbers of intervals of finer grids on which the plan is optimised again if its own
# grid does not lead to feasible arcs, and iterations on them.
GRIDS = (60, 90)
GRID_ITERATIONS = 30
# Largest relative excess of the duration of a refined motion over that of the plan, and
# over that of a plan that its replay does not confirm.
LONGER = 1e-6
UNCONFIRMED = 0.02
# Least number of initial guesses that are tried, largest number of evaluations of the
# dynamics for each of these, and largest number of motors for which other guesses are
# tried.
TRIES = 12
TRY_EVALUATIONS = 40_000
EXPLORED_MOTORS = 3
# Time limit of a refinement [s], for at most EXPLORED_MOTORS motors and for more.
PATIENCE = 45.0
PATIENCE_OF_MANY = 20.0
# Number of intervals, largest number of iterations, tolerance, trust region radius and
# weight of the total variation of the optimisation that turns a guess into a motion.
INTERVALS = 30
ITERATIONS = 25
TOLERANCE = 1e-3
RADIUS = 0.5
SMOOTHING = 1e-4
# Number of further final configurations of guesses, if the goal does not fix one.
ENDS = 3
KEPT = (
    "No exact switching was found that is faster and that the replay confirms: the "
    "motion on the grid was kept."
)
TURNING = (
    "Its switches were not placed exactly: that is not done where a joint with dry "
    "friction turns on the way."
)
# Motions that are shorter by less than this share count as equal.
SAME = 1e-6
# Torques at the ends of an interval, where they may jump, are sampled at this distance
# inside the interval, as a share of it.
INSIDE = 1e-6


@dataclass
class Search:
    """Search for arcs of locally optimal motions.

    Attributes:
        system: The functions of the problem.
        state: The plan, which receives records and incumbents.
        budget: Budget of the whole search.
        limit: Largest duration of a useful motion [s].
        found: Incumbents, each faster than its predecessors.
    """

    system: ProblemFunctions
    state: PlanState
    budget: Budget
    limit: float
    found: list[OptimisedArcs] = field(default_factory=list)

    @property
    def duration(self) -> float:
        """Duration to beat [s]."""
        return self.found[-1].duration * (1.0 - SAME) if self.found else self.limit

    def spent(self, _: Loop) -> Status | None:
        """Stop rule of optimisations on grids: TIME_LIMIT once the budget is spent."""
        return Status.TIME_LIMIT if self.budget.spent else None

    def optimise(self, trajectory: Trajectory, evaluations: int) -> bool:
        """Detect the arcs of a motion and optimise them.

        Args:
            trajectory: The motion, whose states are the guess.
            evaluations: Largest number of evaluations of the dynamics.

        Returns:
            Whether the motion of the optimised arcs is short enough.
        """
        arcs = arcs_of(self.system, trajectory)
        if arcs.count + int(arcs.free.sum()) > MOST_UNKNOWNS or self.budget.spent:
            return False
        budget = self.budget.share(evaluations)

        def states(times: Array) -> Array:
            return np.hstack(trajectory(times)[:2])  # q and v

        motion = refine_arcs(self.system, arcs, states, budget)
        if motion is None:
            return False
        logger.debug("%d arcs: %.9g s", motion.arcs.count, motion.duration)
        if motion.duration <= self.duration:
            self.found.append(motion)
            self.state.keep(motion.program, motion.iterate)
        return motion.duration <= self.limit

    def run(self, plan: Trajectory) -> None:
        """Optimise arcs of the plan, of other guesses, and of finer grids."""
        small = self.system.driven.sum() <= EXPLORED_MOTORS
        options = self.state.options
        near = self.optimise(plan, EVALUATIONS)
        # No multi-start for options with a single start, nor with assumed velocity
        # signs, which other motions would not have.
        if small and options.starts != 1 and self.system.signs is None:
            self._explore(plan)
        most = min(options.max_iterations, GRID_ITERATIONS)
        few = replace(options, max_iterations=most)
        guess = Guess.of_motion(plan)
        for intervals in GRIDS:
            if near or self.budget.spent:
                return
            motion = self._on_grid(few, guess, intervals)
            near = self.optimise(motion, EVALUATIONS)

    def _explore(self, plan: Trajectory) -> None:
        """Multi-start: optimise arcs of motions from other initial guesses."""
        options = self.state.options
        rng = np.random.default_rng(options.seed)
        # A larger option ``starts`` never reduces the number of tries.
        tries = max(TRIES, (options.starts or 1) - 1)
        rough = replace(
            options,
            max_iterations=min(options.max_iterations, ITERATIONS),
            tolerance=max(options.tolerance, TOLERANCE),
            trust_region=RADIUS,
        )
        for _, guess in zip(range(tries), self._detours(plan, rng), strict=False):
            if self.budget.spent:
                return
            motion = self._on_grid(rough, guess, INTERVALS)
            self.optimise(motion, TRY_EVALUATIONS)

    def _detours(self, plan: Trajectory, rng: np.random.Generator) -> Iterator[Guess]:
        """Generate straight lines to the goal, then detours from them, without end."""
        problem, ends = self.system.problem, [plan.q[-1]]
        if problem.goal.configuration is None:
            target = Target(self.system, problem.goal)
            ends += target.configurations(ENDS, rng).best[:ENDS]
        lines = [straight_guess(self.system, end) for end in ends]
        yield from lines
        each = (bumps(self.system, line, rng) for line in lines)
        for detours in zip(*each, strict=True):
            yield from detours

    def _on_grid(self, options: Options, guess: Guess, intervals: int) -> Trajectory:
        """An almost optimal motion with piecewise constant torques on a uniform grid.

        The motion need not keep all constraints.
        """
        shares, duration = interval_shares("uniform", intervals), guess.duration
        grid = CollocationTranscription(self.system, shares, duration)
        start = grid.start(guess.position, duration, np.array([duration]))
        program = NonlinearProgram.of(grid).at(start)
        least = MinimumTime.of(options, SMOOTHING * duration)
        step, settled = trust_regions(options)
        rule = first_of(settled, self.spent)
        found = solve(program, least, start, step, rule, callback=self.state)
        return program.trajectory((found.best or found.iterate).z)


def exact_switches(
    system: ProblemFunctions, best: Candidate, state: PlanState
) -> Candidate:
    """Optimise the switching times of a motion exactly.

    Args:
        system: The functions of the problem.
        best: The candidate with the motion.
        state: The plan, with its options, time limit and callback.

    Returns:
        A candidate with the refined motion, which its replay confirms; the given
        candidate with a remark, if no such motion was found that is at least as fast.
    """
    plan, smooth = best.trajectory, system
    if system.friction is not None:
        signs = constant_signs(system, plan)
        if signs is None:
            return replace(best, remark=TURNING)
        # Arcs are found in torques less dry friction.
        smooth = replace(system, signs=signs)
        plan = plan.with_torques(smooth.dynamics.inverse)
    few = system.driven.sum() <= EXPLORED_MOTORS
    budget = Budget(np.inf, PATIENCE if few else PATIENCE_OF_MANY)
    limit = np.inf
    if best.feasible:
        # A motion that its replay does not confirm may be slightly too fast; if no arcs
        # are about as fast, a finer grid is better.
        limit = plan.duration * (1.0 + (LONGER if best.confirmed else UNCONFIRMED))
    search = Search(smooth, state, budget, limit)
    search.run(plan)
    for motion in reversed(search.found):
        sharp = sharpen(motion)
        iterate = sharp.iterate
        result = SlpResult(Status.CONVERGED, iterate, iterate, (), sharp.program)
        exact = Candidate.of(best.initial, result)
        exact = exact.verified(system.problem, state.options)
        if exact.confirmed:
            return exact
    return replace(best, remark=KEPT)


def arcs_of(system: ProblemFunctions, trajectory: Trajectory) -> Arcs:
    """Approximate arcs of a motion.

    The torque of an interval is the larger one of the torques at its ends: with
    constant accelerations, a torque reaches its limit at one end only.
    """
    t = trajectory.t
    h = np.diff(t)
    ends = [trajectory(t[:-1] + INSIDE * h).u, trajectory(t[1:] - INSIDE * h).u]
    first, last = ((u - system.effort_middle) / system.effort_half for u in ends)
    shares = np.where(np.abs(first) >= np.abs(last), first, last)
    speeds = trajectory.v / system.problem.robot.limits.velocity
    return read_arcs(h, np.clip(shares, -1.0, 1.0), speeds, system.driven)


def constant_signs(system: ProblemFunctions, trajectory: Trajectory) -> Array | None:
    """Velocity signs of joints with dry friction throughout a motion, shape (n,).

    The signs are 1 or -1, and 0 for joints that rest or have no dry friction. None if a
    joint with dry friction reverses.
    """
    dry, ways = system.problem.robot.friction > 0.0, trajectory.turns.first
    forth, back = np.any(ways > 0.0, axis=0), np.any(ways < 0.0, axis=0)
    turns = trajectory.turns.of_joints(dry).size or np.any(dry & forth & back)
    return None if turns else np.where(dry, 1.0 * forth - 1.0 * back, 0.0)
