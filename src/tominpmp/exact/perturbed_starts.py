"""Multi-start for switching refinement: motions near other local optima.

The same problem often has several locally time-optimal motions, which differ by the
order of their switches and are not connected by small changes. Randomly perturbed paths
lead to them: an optimisation of torques on a coarse grid turns each path into a motion
near a local optimum, whose arcs are then optimised. For a single motor, local optima
differ by the number of switches only, and all small numbers are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, repeat

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exact.structure import Arcs
from tominpmp.exact.switching_times import OptimisedArcs, solve_lengths
from tominpmp.initial_guess.inverse_kinematics import Target, find_configurations
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

# Number of intervals, largest number of iterations, tolerance, trust region radius and
# weight of the total variation of the optimisation that turns a path into a motion.
INTERVALS = 30
ITERATIONS = 25
TOLERANCE = 1e-3
RADIUS = 0.5
SMOOTHING = 1e-4
# Number of sine waves that are added to a path, their amplitude [rad], and the standard
# deviation of the logarithm of its duration.
WAVES = 3
AMPLITUDE = 1.0
SPREAD = 0.3
# Number of final configurations of perturbed paths, if the goal does not fix one.
ENDS = 8
# Least and largest number of arcs of motions of a single motor.
FEWEST, MOST = 2, 8
# Number of steps over a whole motion, and of evaluations of the dynamics, in the first
# solve of such a motion.
ROUGH_STEPS = 24
ROUGH_EVALUATIONS = 10_000
# Largest violation of goal and limits of motions that are optimised further.
PROMISING = 1e-2


def on_grid(
    system: ProblemFunctions,
    options: Options,
    callback: Callback,
    path: Array,
    duration: float,
) -> Trajectory:
    """An almost optimal motion with piecewise constant torques on a uniform grid.

    The motion need not keep all constraints.

    Args:
        system: The functions of the problem.
        options: Options of the optimisation.
        callback: Called with the record of each iteration.
        path: Initial positions at the nodes, shape (N + 1, n) [rad or m].
        duration: Initial duration [s].
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
    """Generate motions from randomly perturbed paths, without end."""
    rough = replace(
        options,
        max_iterations=min(options.max_iterations, ITERATIONS),
        tolerance=max(options.tolerance, TOLERANCE),
        trust_region=RADIUS,
    )
    limits = system.problem.robot.limits
    start, goal, ends = system.problem.q_start, system.problem.goal, [plan.q[-1]]
    if goal.configuration is None:
        ends += find_configurations(Target(system, goal), ENDS, rng).best
    s = np.linspace(0.0, 1.0, INTERVALS + 1)[:, None]
    reach = AMPLITUDE * np.minimum(
        system.step_scale, limits.position_upper - limits.position_lower
    )
    # The first path is straight, which often leads to the best motion.
    for amplitude in chain([np.zeros_like(reach)], repeat(reach)):
        end = ends[int(rng.integers(len(ends)))]
        path = start + s * (end - start)
        for wave in range(1, WAVES + 1):
            height = rng.normal(size=system.n) * amplitude
            path = path + height * np.sin(wave * np.pi * s)
        path = np.clip(path, limits.position_lower, limits.position_upper)
        duration = plan.duration * float(np.exp(rng.normal(0.0, SPREAD)))
        yield on_grid(system, rough, callback, path, duration)


def single_motor_motions(
    system: ProblemFunctions,
    duration: float,
    rng: np.random.Generator,
    budget: Budget,
) -> Iterator[OptimisedArcs]:
    """Generate bang-bang motions of a single motor that almost reach the goal.

    The number of switches increases from one.

    Args:
        system: The functions of the problem.
        duration: Approximate duration of the motions [s].
        rng: Source of random lengths of the arcs.
        budget: Budget for all motions.
    """
    joint = driven_joints(system)
    for count in range(FEWEST, MOST + 1):
        for sign in (1.0, -1.0):
            if budget.spent:
                return
            levels = np.zeros((count, system.n))
            levels[:, joint] = sign * (-1.0) ** np.arange(count)[:, None]
            lengths = rng.dirichlet(np.full(count, 2.0)) * duration
            held = np.zeros(levels.shape, dtype=np.int64)
            arcs = Arcs(lengths, levels, held.astype(bool), held)
            share = budget.share(ROUGH_EVALUATIONS)
            found = solve_lengths(system, arcs, None, share, ROUGH_STEPS)
            budget.deduct(share)
            if found is not None and found.violation < PROMISING:
                yield found
