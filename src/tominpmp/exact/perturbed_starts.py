"""Perturbed starts: motions to read arcs from that may lead to other local optima.

Time-optimal motions of the same arm between the same states often come in several
kinds that differ by the order of the switches, and no small change leads from one to
another. Randomly perturbed paths do: torques on a coarse grid lead from them to a
motion near to some optimum, whose arcs are then optimised. For a single motor the
number of switches is the only difference, and all of them are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, repeat

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exact.structure import Arcs
from tominpmp.exact.switching_times import OptimisedArcs, solve_lengths
from tominpmp.initial_guess.inverse_kinematics import find_configurations
from tominpmp.motion.trajectory import Trajectory
from tominpmp.options import Options
from tominpmp.solvers.loop import Callback, solve
from tominpmp.solvers.objective import MinimumTime
from tominpmp.solvers.trust_region_step import trust_regions
from tominpmp.stopping import Budget
from tominpmp.transcription.collocation import CollocationTranscription
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.grid import interval_shares
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.transcription.program import NonlinearProgram

# Grid of torques on which a perturbed path becomes a motion, and its iterations.
INTERVALS = 30
ITERATIONS = 25
TOLERANCE = 1e-3
RADIUS = 0.5
SMOOTHING = 1e-4
# Sine waves added to a path, their amplitude [rad], and the spread of the logarithm of
# its duration.
WAVES = 3
AMPLITUDE = 1.0
SPREAD = 0.3
# Configurations at the goal that perturbed paths end at, where it leaves several.
ENDS = 8
# Arcs of a motion with a single motor, and how many random lengths are tried of each.
FEWEST, MOST = 2, 8
# Steps over a whole motion and evaluations of the dynamics in a first, rough solve.
ROUGH_STEPS = 24
ROUGH_EVALUATIONS = 10_000
# What it may miss the goal by to go on.
PROMISING = 1e-2


def on_grid(
    system: ProblemFunctions,
    options: Options,
    callback: Callback,
    path: Array,
    duration: float,
) -> Trajectory:
    """A motion with torques that are constant on equal intervals, near to optimal.

    It begins with positions at the nodes, shape (N + 1, n) [rad or m], takes about the
    given duration [s], and need not keep all constraints.
    """
    shares = interval_shares("uniform", path.shape[0] - 1)
    grid = CollocationTranscription(system, shares, duration)
    start = grid.start(path, np.array([duration]))
    program = NonlinearProgram.of(grid).at(start)
    least = MinimumTime.of(options, SMOOTHING * duration)
    method = trust_regions(options)
    found = solve(program, least, start, *method, callback=callback)
    last = found.iterate if found.best is None else found.best
    return program.trajectory(last.z)


def perturbed_motions(
    system: ProblemFunctions,
    options: Options,
    callback: Callback,
    plan: Trajectory,
    rng: np.random.Generator,
) -> Iterator[Trajectory]:
    """Motions from randomly perturbed paths, without end."""
    rough = replace(
        options,
        max_iterations=min(options.max_iterations, ITERATIONS),
        tolerance=max(options.tolerance, TOLERANCE),
        trust_region=RADIUS,
    )
    limits = system.problem.robot.limits
    start, goal, ends = system.problem.q_start, system.problem.goal, [plan.q[-1]]
    if goal.configuration is None:
        ends += find_configurations(system, goal, ENDS, rng).best
    s = np.linspace(0.0, 1.0, INTERVALS + 1)[:, None]
    reach = AMPLITUDE * np.minimum(
        system.step_scale, limits.position_upper - limits.position_lower
    )
    # The first path is straight; it often leads to the best motion.
    for amplitude in chain([np.zeros_like(reach)], repeat(reach)):
        end = ends[int(rng.integers(len(ends)))]
        path = start + s * (end - start)
        for wave in range(1, WAVES + 1):
            bend = rng.normal(size=system.n) * amplitude
            path = path + bend * np.sin(wave * np.pi * s)
        path = np.clip(path, limits.position_lower, limits.position_upper)
        duration = plan.duration * float(np.exp(rng.normal(0.0, SPREAD)))
        yield on_grid(system, rough, callback, path, duration)


def single_motor_motions(
    system: ProblemFunctions,
    duration: float,
    rng: np.random.Generator,
    budget: Budget,
) -> Iterator[OptimisedArcs]:
    """Rough motions of a single motor that nearly reach the goal: one switch, two, ...

    They take about the given duration [s].
    """
    joint = driven_joints(system)
    for count in range(FEWEST, MOST + 1):
        for sign in (1.0, -1.0):
            if budget.spent:
                return
            levels = np.zeros((count, system.n))
            levels[:, joint] = sign * (-1.0) ** np.arange(count)[:, None]
            lengths = rng.dirichlet(np.full(count, 2.0)) * duration
            none = np.zeros(levels.shape, dtype=np.int64)
            arcs = Arcs(lengths, levels, none.astype(bool), none)
            share = budget.share(ROUGH_EVALUATIONS)
            found = solve_lengths(system, arcs, None, share, ROUGH_STEPS)
            budget.deduct(share)
            if found is not None and found.miss < PROMISING:
                yield found
