"""A path first, its timing afterwards: RRT-Connect, path simplification, TOPP-RA.

This is the most common method today. OMPL's RRT-Connect finds a collision-free path and
OMPL's simplifier shortens it (``simplifyMax``: shortcuts, removal of vertices, B-spline
smoothing). A cubic spline is drawn through its waypoints; as long as it is in collision
or exceeds a joint limit, waypoints are added in the middle of all segments,
which brings it closer to the path. TOPP-RA gives the fastest timing of the spline
within the limits of velocity and torque. Limits hold at the steps of TOPP-RA; if a
velocity exceeds its limit between them, by 1 % where a path bends sharply, the whole
motion is slowed down accordingly, which also keeps the torques within their limits.

TOPP-RA does not support viscous friction. The friction torque at full speed is
reserved for it; with the 0.003 N m s/rad of a Panda this is 0.07 % of the torque.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import toppra
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou
from toppra.algorithm import TOPPRA
from toppra.constraint import (
    DiscretizationType,
    JointTorqueConstraint,
    JointVelocityConstraint,
)

from .arm import Arm, Array, Sampler, TorqueModel

# Longest step between two collision checks [rad]; the finer one if a path turns
# out to be in collision between the checks.
RESOLUTIONS = (0.02, 0.005)
# Share of a joint's range by which the spline may overshoot a waypoint at its limit.
POSITION_SLACK = 2e-3
# Number of times that waypoints are added before the spline is given up.
MAX_SUBDIVISIONS = 7
# Steps along the path per segment, and in all at least, for the timing.
STEPS_PER_SEGMENT, MIN_STEPS = 16, 400


@dataclass(frozen=True)
class RrtToppraResult:
    """Results of the two stages.

    Attributes:
        T: Duration in [s]; nan unless solved.
        status: Status, in a word.
        waypoints: Waypoints of the spline, shape (k, n).
        subdivisions: Number of times that waypoints were added.
        path_seconds: Processor time of search and simplification [s].
        timing_seconds: Processor time of spline, its checks and its timing [s].
        motion: Times to q, v, a; None unless solved.
        knots: Times between which the motion is smooth, from 0 to T.
    """

    T: float
    status: str
    waypoints: Array | None
    subdivisions: int
    path_seconds: float
    timing_seconds: float
    motion: Sampler | None
    knots: Array | None

    @property
    def success(self) -> bool:
        """Whether there is a motion."""
        return self.motion is not None


@dataclass(frozen=True)
class Timing:
    """Fastest timing of a path: Toppra's status, T [s], the motion, its knots."""

    status: str
    T: float
    motion: Sampler | None
    knots: Array | None


def solve(
    arm: Arm,
    q_start: Array,
    q_goal: Array,
    is_free: Callable[[Array], bool],
    is_clear: Callable[[Array], bool],
    *,
    seed: int = 1,
    max_seconds: float = 30.0,
) -> RrtToppraResult:
    """Find a path and time it.

    Args:
        arm: The robot.
        q_start: Start, shape (n,).
        q_goal: Goal, shape (n,).
        is_free: Whether a configuration, shape (n,), is collision-free.
        is_clear: Whether successive configurations, shape (m, n), are collision-free.
        seed: Seed of OMPL.
        max_seconds: Limit of the search for a path [s].
    """
    low, high = _position_limits(arm)
    path_seconds = timing_seconds = 0.0
    timing, points, rounds = Timing("no path", np.nan, None, None), None, 0
    for resolution in RESOLUTIONS:
        started = time.process_time()
        points = plan_path(
            arm,
            q_start,
            q_goal,
            is_free,
            resolution,
            seed=seed,
            max_seconds=max_seconds,
        )
        found = time.process_time()
        path_seconds += found - started
        if points is None:
            break
        timing, rounds = Timing("touching", np.nan, None, None), 0
        while rounds <= MAX_SUBDIVISIONS:
            path = spline(points)
            q = path(np.linspace(0.0, path.duration, count_samples(points)))
            if np.all((q >= low) & (q <= high)) and is_clear(q):
                timing = time_path(arm, path, len(points))
                break
            points = subdivide(points)
            rounds += 1
        timing_seconds += time.process_time() - found
        if timing.motion is not None:
            break
    return RrtToppraResult(
        timing.T,
        timing.status,
        points,
        rounds,
        path_seconds,
        timing_seconds,
        timing.motion,
        timing.knots,
    )


def _position_limits(arm: Arm) -> tuple[Array, Array]:
    """Position limits with some slack."""
    slack = POSITION_SLACK * (arm.position_upper - arm.position_lower)
    return arm.position_lower - slack, arm.position_upper + slack


def plan_path(
    arm: Arm,
    q_start: Array,
    q_goal: Array,
    is_free: Callable[[Array], bool],
    resolution: float,
    *,
    seed: int = 1,
    max_seconds: float = 30.0,
) -> Array | None:
    """Waypoints of a simplified path; None if no path was found.

    Args:
        arm: The robot, with finite position limits.
        q_start: Start, shape (n,).
        q_goal: Goal, shape (n,).
        is_free: Whether a configuration, shape (n,), is collision-free.
        resolution: Longest step between two collision checks [rad].
        seed: Seed of OMPL.
        max_seconds: Limit of the search [s].

    Returns:
        Shape (k, n), from start to goal.
    """
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed)
    space = ob.RealVectorStateSpace(arm.n)
    bounds = ob.RealVectorBounds(arm.n)
    for joint in range(arm.n):
        # Starts and goals on a limit must not be outside by rounding.
        bounds.setLow(joint, float(arm.position_lower[joint]) - 1e-9)
        bounds.setHigh(joint, float(arm.position_upper[joint]) + 1e-9)
    space.setBounds(bounds)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(
        lambda state: is_free(np.array([state[joint] for joint in range(arm.n)]))
    )
    information = setup.getSpaceInformation()
    extent = float(space.getMaximumExtent())
    information.setStateValidityCheckingResolution(resolution / extent)
    start, goal = space.allocState(), space.allocState()
    for joint in range(arm.n):
        start[joint], goal[joint] = float(q_start[joint]), float(q_goal[joint])
    setup.setStartAndGoalStates(start, goal)
    setup.setPlanner(og.RRTConnect(information))
    setup.solve(max_seconds)
    if not setup.haveExactSolutionPath():
        return None
    path = setup.getSolutionPath()
    og.PathSimplifier(information).simplifyMax(path)
    points = np.array(
        [[state[joint] for joint in range(arm.n)] for state in path.getStates()]
    )
    points[0], points[-1] = q_start, q_goal
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    return np.concatenate([points[:1], points[1:][moved]])


def spline(points: Array) -> toppra.SplineInterpolator:
    """Cubic spline through waypoints, over the length of the chords."""
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    stations = np.concatenate([[0.0], np.cumsum(chords)])
    return toppra.SplineInterpolator(stations, points, bc_type="not-a-knot")


def subdivide(points: Array) -> Array:
    """Add the middle of each segment."""
    out = np.empty((2 * len(points) - 1, points.shape[1]))
    out[::2] = points
    out[1::2] = 0.5 * (points[1:] + points[:-1])
    return out


def count_samples(points: Array) -> int:
    """Configurations along a path, dense enough not to miss collisions."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return int(np.ceil(length / min(RESOLUTIONS))) + 2


def time_path(arm: Arm, path: toppra.SplineInterpolator, points: int) -> Timing:
    """Fastest timing of a path from rest to rest.

    Args:
        arm: The robot.
        path: The path.
        points: Number of its waypoints.

    Returns:
        The timing.
    """
    logging.getLogger("toppra").setLevel(logging.ERROR)
    steps = max(MIN_STEPS, STEPS_PER_SEGMENT * (points - 1))
    # Dense at both ends, where an even grid loses time.
    shares = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, steps + 1)))
    grid = path.duration * shares
    torque = TorqueModel(arm)
    reserve = arm.damping * arm.velocity
    efforts = np.stack([arm.effort_lower + reserve, arm.effort_upper - reserve], axis=1)

    def undamped(q: Array, v: Array, a: Array) -> Array:
        return torque(q, v, a) - arm.damping * v

    constraints = [
        JointVelocityConstraint(np.stack([-arm.velocity, arm.velocity], axis=1)),
        JointTorqueConstraint(
            undamped,
            efforts,
            np.zeros(arm.n),
            discretization_scheme=DiscretizationType.Interpolation,
        ),
    ]
    algorithm = TOPPRA(constraints, path, gridpoints=grid, solver_wrapper="seidel")
    _, speeds, _ = algorithm.compute_parameterization(0.0, 0.0)
    status = str(algorithm.problem_data.return_code.name)
    if speeds is None or not np.all(np.isfinite(speeds)):
        return Timing(status, np.nan, None, None)
    speeds = speeds / max(1.0, _fastest(arm, path, grid, speeds))
    # The path's acceleration is constant between grid points.
    lengths = 2.0 * np.diff(grid) / (speeds[1:] + speeds[:-1])
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    rates = np.diff(speeds) / lengths

    def motion(times: Array) -> tuple[Array, Array, Array]:
        k = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(rates) - 1)
        elapsed = times - knots[k]
        s = grid[k] + elapsed * (speeds[k] + 0.5 * elapsed * rates[k])
        s = np.clip(s, 0.0, grid[-1])
        rate = (speeds[k] + elapsed * rates[k])[:, None]
        slope = path(s, 1)
        return path(s), slope * rate, path(s, 2) * rate**2 + slope * rates[k][:, None]

    return Timing(status, float(knots[-1]), motion, knots)


def _fastest(
    arm: Arm, path: toppra.SplineInterpolator, grid: Array, speeds: Array
) -> float:
    """Largest joint speed of a timed path, in shares of the limit."""
    between = np.linspace(0.0, 1.0, 6)[:, None]
    s = (grid[:-1] + between * np.diff(grid)).ravel()
    # The square of the path speed is linear between grid points.
    rates = np.sqrt((speeds[:-1] ** 2 + between * np.diff(speeds**2)).ravel())
    return float(np.max(np.abs(path(s, 1)) * rates[:, None] / arm.velocity))
