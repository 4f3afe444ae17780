"""Grid refinement: intervals are split where the motion needs it, coarse to fine.

With constant accelerations an interval loses time where its torques change along the
way, since they come to a limit at one instant of it only, and where a torque would
rather switch inside. With constant torques it loses time by the switches alone, and
steps that are too long are wrong: the end of each interval is compared with that of a
more accurate method. Splitting an interval leaves the motion as it is, so that the next
solve begins where the last one ended.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from tominpmp.arrays import Array, BoolArray
from tominpmp.constraints.friction import interval_signs
from tominpmp.dynamics import Dynamics
from tominpmp.linear_programs import LpSolver
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options, Tolerances
from tominpmp.planner.progress import Progress
from tominpmp.solvers.exchange import RowExchange
from tominpmp.solvers.iterate import SlpResult
from tominpmp.solvers.rounds import solve_in_rounds
from tominpmp.solvers.slp import SlpSolver
from tominpmp.transcription.base import Program
from tominpmp.transcription.bends import missing_torque, torques_at_ends
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.inverse import InverseTranscription
from tominpmp.transcription.layout import split_intervals
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram
from tominpmp.verification.verification import verify

logger = logging.getLogger(__name__)

# Rounds of splitting, and the largest number of intervals.
ROUNDS = 4
MOST_INTERVALS = 200
# Relative gain of a round below which the next is spared if the replay is all right.
SETTLED = 1e-3
# Shares of all intervals that are split at least and at most in a round.
FEWEST, MOST = 0.1, 0.5
# Intervals are split that lose this share of what the worst one loses.
WORST_SHARE = 0.15
# Losses below this share of the duration are none.
LITTLE = 1e-6
# Torques that change by more than this, in half ranges, switch: to the other limit, or
# to what keeps a speed.
JUMP = 0.5
# Iterations of each solve.
ITERATIONS = 30
# Weight of the total variation, as a share of the duration.
SMOOTHING_SHARE = 1e-4

Gridded = InverseTranscription | CollocationTranscription


def refine_grid(
    system: ProblemFunctions,
    options: Options,
    program: Program,
    result: SlpResult,
    lp: LpSolver,
    progress: Progress,
) -> tuple[Program, SlpResult]:
    """Split intervals until the motion is accurate and gains little more.

    Args:
        system: The functions of the problem.
        options: Options of the plan.
        program: The program of the motion, "inverse" or "collocation"; others are
            handed back with a remark.
        result: Its solution.
        lp: Solver of linear programs.
        progress: Time limit and callback.

    Returns:
        Program and solution on the finest grid that brought anything.
    """
    if isinstance(program, NonlinearProgram) and isinstance(
        program.transcription, InverseTranscription | CollocationTranscription
    ):
        return _refine(system, options, program, result, lp, progress)
    remark = (
        f"Its grid was not refined: that is not done for method {options.method!r}."
    )
    return program, replace(result, remark=remark)


def _refine(
    system: ProblemFunctions,
    options: Options,
    program: NonlinearProgram,
    result: SlpResult,
    lp: LpSolver,
    progress: Progress,
) -> tuple[NonlinearProgram, SlpResult]:
    best = program, result
    for _ in range(ROUNDS):
        kept, outcome = best
        if progress.over or outcome.best is None:
            break
        z, T = outcome.best.z, outcome.best.duration
        grid = kept.transcription
        assert isinstance(grid, Gridded)  # noqa: S101
        losses = interval_losses(system, grid, z)
        split = worst_intervals(losses, T)
        if not np.any(split):
            break
        finer, start = split_intervals(grid, z, split)
        assert isinstance(finer, Gridded)  # noqa: S101
        refined, found = _solve(finer, start, options, outcome, lp, progress)
        replayed = replayed_well(system, refined.trajectory(_last(found)), options)
        gain = 1.0 - (np.inf if found.best is None else found.best.duration) / T
        count = losses.size + int(split.sum())
        logger.info("%d intervals: gain %.1e, replay %s", count, gain, replayed)
        if found.best is None or (gain < 0.0 and not replayed):
            break
        better = gain > 0.0 or not replayed_well(system, kept.trajectory(z), options)
        if better:
            best = refined, found
        if replayed and gain < SETTLED:
            break
    return best


def _last(result: SlpResult) -> Array:
    return (result.iterate if result.best is None else result.best).z


def replayed_well(
    system: ProblemFunctions, trajectory: Trajectory, options: Options
) -> bool:
    """Whether the replay of a motion ends at the goal and keeps all limits."""
    tolerances = Tolerances(
        goal=options.goal_tolerance,
        speed=options.speed_tolerance,
        limits=options.limit_tolerance,
        contact=options.contact_tolerance,
    )
    checker = system.problem.checker
    return verify(system.problem, trajectory, tolerances, checker=checker).ok


def interval_losses(
    system: ProblemFunctions, transcription: Gridded, z: Array
) -> Array:
    """Time that each interval may lose by its length, roughly, shape (N,) [s].

    Args:
        system: The functions of the problem.
        transcription: The parameterisation.
        z: An iterate of it.
    """
    if isinstance(transcription, InverseTranscription):
        return _spline_losses(transcription, z)
    x, u, h = transcription.split(z)
    shares = (u - system.effort_middle) / system.effort_half
    if system.friction is not None:
        shares = shares + system.friction * interval_signs(x[:, system.n :])[0]
    error = step_errors(system, x, u, h)
    unsharp = np.max(1.0 - np.abs(shares), axis=1) * np.max(_jumps(shares), axis=1)
    # An error of the state costs the time in which it is made at the typical speed.
    scale = np.concatenate([system.step_scale, 5.0 / h.sum() * system.step_scale])
    return np.asarray(h * 0.25 * unsharp + h.sum() * np.max(error / scale, axis=1))


def _spline_losses(transcription: InverseTranscription, z: Array) -> Array:
    h = transcription.motion(z).h
    begin, end = torques_at_ends(transcription, z)
    missing = missing_torque(begin, end)
    middle = 0.5 * (begin + end)
    unsharp = np.maximum(1.0 - np.maximum(np.abs(begin), np.abs(end)), 0.0)
    unsharp = np.max(unsharp * _jumps(middle), axis=1)
    return np.asarray(h * (0.5 * missing + 0.25 * unsharp))


def _jumps(shares: Array) -> Array:
    """Where torques jump around an interval, shape (N, n): 1, else 0."""
    padded = np.vstack([shares[:1], shares, shares[-1:]])
    return np.asarray(np.abs(padded[2:] - padded[:-2]) > JUMP).astype(np.float64)


def step_errors(system: ProblemFunctions, x: Array, u: Array, h: Array) -> Array:
    """Errors of the steps of an integrator of order 3, shape (N, 2n).

    Args:
        system: Dynamics.
        x: States at the nodes, shape (N + 1, 2n).
        u: Torques of the intervals, shape (N, n) [N m or N].
        h: Lengths of the intervals [s], shape (N,).

    Returns:
        How far two steps of half the length end from the next node, zero where an
        explicit method does not do: stiff joints do not ask for short steps.
    """
    half = 0.5 * h[:, None]
    with np.errstate(all="ignore"):
        middle = _runge_kutta_step(system.dynamics, x[:-1], u, half)
        end = _runge_kutta_step(system.dynamics, middle, u, half)
    out = np.abs(end - x[1:])
    return np.asarray(np.where(np.isfinite(out) & (out < 0.1), out, 0.0))


def _runge_kutta_step(dynamics: Dynamics, x: Array, u: Array, h: Array) -> Array:
    """States after steps of the classical method of order 4, shape (N, 2n)."""
    k1 = dynamics.forward(x, u)
    k2 = dynamics.forward(x + 0.5 * h * k1, u)
    k3 = dynamics.forward(x + 0.5 * h * k2, u)
    k4 = dynamics.forward(x + h * k3, u)
    return np.asarray(x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


def worst_intervals(losses: Array, duration: float) -> BoolArray:
    """Which intervals are to be split, shape (N,).

    Args:
        losses: Time that each may lose [s].
        duration: T [s].
    """
    N = losses.size
    most = min(int(np.ceil(MOST * N)), MOST_INTERVALS - N)
    split = np.zeros(N, dtype=bool)
    if most <= 0 or losses.max() < LITTLE * duration:
        return split
    order = np.argsort(-losses)
    wanted = int(np.sum(losses >= WORST_SHARE * losses.max()))
    count = min(max(wanted, int(np.ceil(FEWEST * N))), most)
    chosen = order[:count]
    split[chosen[losses[chosen] >= LITTLE * duration]] = True
    return split


def _solve(
    transcription: Gridded,
    z: Array,
    options: Options,
    before: SlpResult,
    lp: LpSolver,
    progress: Progress,
) -> tuple[NonlinearProgram, SlpResult]:
    """Solve on a new grid, with rows between the nodes where they are needed."""
    smoothing = options.smoothing
    if smoothing is None:
        smoothing = SMOOTHING_SHARE * before.iterate.duration
    few = replace(options, max_iterations=min(options.max_iterations, ITERATIONS))
    program = NonlinearProgram.of(transcription).at(z)

    def solve(
        program: NonlinearProgram, z: Array, options: Options, after: SlpResult | None
    ) -> SlpResult:
        solver = SlpSolver(
            program,
            options,
            smoothing,
            lp,
            progress,
            keep=progress.keep,
            exchange=RowExchange(),
        )
        result = solver.run(z, after=after)
        if after is None:
            # The rows are others than before: only the history goes on.
            result = replace(result, history=before.history + result.history)
        return result

    return solve_in_rounds(program, z, few, solve, rough=False)
