"""Paths around obstacles, by RRT-Connect and path simplification of OMPL.

OMPL seeds its random numbers once a process; but objects made after the seed was set
again draw from that seed, so that a path depends on its seed alone (and on when the
search was stopped, which is why collision checks rather than time limit the work).
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import optional
from tominpmp.transcription.problem_functions import PADDING, ProblemFunctions

# Ranges of the planner, the longest branches that are grown at once [rad]; tries take
# turns. On the Panda among shelves and tables 0.5 finds 9 of 10 paths in half a second,
# a fifth of OMPL's choice (2.7), and 0.25 the paths through the narrowest gaps.
RANGES = (0.5, 0.25)
# Distance of the configurations that are checked on a branch [rad].
RESOLUTION = 0.05
# Collision checks for a path, before it is simplified.
CHECKS = 40_000
# Distance of the points between which shortcuts are sought [rad].
SHORTCUT_SPACING = 0.5
# Distance beyond both ends to which joints without narrow limits are sampled [rad].
MARGIN = np.pi
# Points at which two paths are compared, and the distance below which they are alike
# [rad].
SAMPLES = 24
NEAR = 0.3
# Tries in a row without a new path that end the search, beside one for each end.
TRIES = 4


class _OutOfTime(Exception):
    """Raised in the validity checker to end a search of OMPL at the deadline."""


def sampling_available() -> bool:
    """Whether OMPL is installed."""
    return importlib.util.find_spec("ompl") is not None


def is_free(system: ProblemFunctions, q: Array) -> bool:
    """Whether a configuration, shape (n,), keeps the required clearance."""
    return check_of(system)(q)


def check_of(system: ProblemFunctions) -> Callable[[Array], bool]:
    """A collision check like :func:`is_free`, set up once for many configurations."""
    if system.watched is None:
        return lambda _: True
    checker = system.problem.checker

    def of_pieces() -> Callable[[Array], bool]:
        clearance = system.clearance
        if clearance is None:
            return lambda _: True
        return partial(clearance.checker.is_free, margin=clearance.margin)

    if not checker.single_arm:
        return of_pieces()
    # Convex pieces are not needed where the links are clear as one hull each.
    return lambda q: checker.hulls_clear(q, PADDING) or of_pieces()(q)


def sample_paths(
    system: ProblemFunctions,
    ends: Sequence[Array],
    rng: np.random.Generator,
    *,
    known: Sequence[Array] = (),
    checks: int = CHECKS,
    deadline: float = np.inf,
) -> Iterator[Array]:
    """Paths that differ, from the start of a problem to given ends in turn.

    Paths that can be shifted into each other lead to the same motion: on the Panda
    among shelves and tables their optima agreed to 0.1 % in all of 15 cases.

    Args:
        system: Start, limits and clearance.
        ends: Final configurations, each of shape (n,) [rad or m].
        rng: Random numbers; the paths depend on them alone unless time runs out.
        known: Free paths; paths like them are left out; each of shape (m, n).
        checks: Collision checks for each path.
        deadline: When to stop, as a value of :func:`time.perf_counter` [s].

    Yields:
        Corners of a path, shape (m, n). The search is lazy.

    Raises:
        MissingDependency: If OMPL is not installed.
    """
    found = list(known)
    ends = [q for q in ends if is_free(system, q)]
    in_vain = number = 0
    while ends and in_vain < TRIES + len(ends):
        if time.perf_counter() > deadline:
            return
        end = ends[number % len(ends)]
        reach = RANGES[number // len(ends) % len(RANGES)]
        number += 1
        seed, limits = int(rng.integers(1, 2**31)), (checks, deadline)
        path = sample_path(system, end, seed, reach, *limits)
        in_vain += 1
        if path is None or any(alike(system, path, other) for other in found):
            continue
        in_vain = 0
        found.append(path)
        yield path


def sample_path(
    system: ProblemFunctions,
    q_end: Array,
    seed: int,
    reach: float = RANGES[0],
    checks: int = CHECKS,
    deadline: float = np.inf,
) -> Array | None:
    """A path that keeps clear of obstacles, simplified.

    Args:
        system: Start, limits and clearance.
        q_end: Final configuration, shape (n,) [rad or m].
        seed: Seed of the random numbers, at least 1.
        reach: Longest branch that is grown at once [rad].
        checks: Largest number of collision checks before the simplification.
        deadline: When to stop, as a value of :func:`time.perf_counter` [s].

    Returns:
        Corners, shape (m, n); None if no path was found.

    Raises:
        MissingDependency: If OMPL is not installed.
    """
    with optional("ompl", "sampling", "looking for paths around obstacles"):
        from ompl import base, geometric, util
    if not (is_free(system, system.problem.q_start) and is_free(system, q_end)):
        return None  # OMPL would wait for another end
    level = util.getLogLevel()
    util.setLogLevel(util.LogLevel.LOG_NONE)
    try:
        util.RNG.setSeed(seed)
        validity = _Validity(system, checks, deadline)
        definition = _definition(base, system, q_end, validity)
        info = definition.getSpaceInformation()
        planner = geometric.RRTConnect(info)
        planner.setRange(reach)
        planner.setProblemDefinition(definition)
        planner.setup()
        try:
            planner.solve(base.PlannerTerminationCondition(validity.enough))
        except _OutOfTime:
            return None
        if not definition.hasExactSolution():
            return None
        path = definition.getSolutionPath()
        corners = _corners(system, path, q_end)
        simplifier = geometric.PathSimplifier(info)
        try:
            simplifier.reduceVertices(path)
            # The path gets as short as with all of OMPL's methods in turn, in two
            # thirds of the time.
            simplifier.ropeShortcutPath(path, SHORTCUT_SPACING)
            simplifier.reduceVertices(path)
        except _OutOfTime:
            return corners
        return _corners(system, path, q_end)
    finally:
        util.setLogLevel(level)


class _Validity:
    """Whether a state of OMPL is free; counts its calls.

    OMPL keeps a reference to this checker, so the checker must not hold any of OMPL's
    objects: the reference cycle would never be freed.
    """

    def __init__(self, system: ProblemFunctions, most: int, deadline: float) -> None:
        self.system, self.deadline, self.free = system, deadline, check_of(system)
        self.most, self.checks, self.asked = most, 0, 0

    def __call__(self, state: Any) -> bool:
        self.checks += 1
        if time.perf_counter() > self.deadline:
            raise _OutOfTime
        return self.free(_configuration(self.system, state))

    def enough(self) -> bool:
        """Whether the budget of collision checks is used up; calls of this count too.

        A search that never checks a state ends as well by this count.
        """
        self.asked += 1
        return self.checks + self.asked >= self.most


def _configuration(system: ProblemFunctions, state: Any) -> Array:
    """Joint positions of a state, which has lengths in units of the reach."""
    return np.array([state[i] for i in range(system.n)]) * system.step_scale


def _corners(system: ProblemFunctions, path: Any, q_end: Array) -> Array:
    corners = np.array([_configuration(system, state) for state in path.getStates()])
    corners[0], corners[-1] = system.problem.q_start, q_end
    return corners


def _definition(
    base: Any, system: ProblemFunctions, q_end: Array, validity: _Validity
) -> Any:
    """The problem as OMPL has it."""
    limits, q_start = system.problem.robot.limits, system.problem.q_start
    span = MARGIN * system.step_scale
    low = np.maximum(limits.position_lower, np.minimum(q_start, q_end) - span)
    high = np.minimum(limits.position_upper, np.maximum(q_start, q_end) + span)
    low, high = low / system.step_scale, high / system.step_scale
    bounds = base.RealVectorBounds(system.n)
    for i in range(system.n):
        bounds.setLow(i, float(low[i]))
        bounds.setHigh(i, float(high[i]))
    space = base.RealVectorStateSpace(system.n)
    space.setBounds(bounds)
    info = base.SpaceInformation(space)
    info.setStateValidityChecker(validity)
    # OMPL takes a share of the extent, which is small where joints have little room.
    extent = max(space.getMaximumExtent(), 2.0 * RESOLUTION)
    info.setStateValidityCheckingResolution(RESOLUTION / extent)
    info.setup()
    states = info.allocState(), info.allocState()
    for state, q in zip(states, (q_start, q_end), strict=True):
        for i, value in enumerate(np.clip(q / system.step_scale, low, high)):
            state[i] = float(value)
    definition = base.ProblemDefinition(info)
    definition.setStartAndGoalStates(*states)
    return definition


def is_free_line(system: ProblemFunctions, one: Array, other: Array) -> bool:
    """Whether the straight line between two configurations is free."""
    length = float(np.linalg.norm((other - one) / system.step_scale))
    shares = np.linspace(0.0, 1.0, 2 + int(length / RESOLUTION))
    return all(is_free(system, one + share * (other - one)) for share in shares)


def alike(system: ProblemFunctions, one: Array, other: Array) -> bool:
    """Whether two paths are near, or homotopic by a straight shift.

    Args:
        system: Clearance and scales.
        one: Corners, shape (m, n).
        other: Corners, shape (k, n).

    Returns:
        True also for paths of one homotopy class, as far as a straight shift between
        points at equal shares of their lengths tells.
    """
    one, other = (_resampled(path / system.step_scale) for path in (one, other))
    if np.max(np.abs(one - other)) < NEAR:
        return True
    if np.max(np.abs(one[-1] - other[-1])) > NEAR:
        return False
    between = [
        (one + share * (other - one)) * system.step_scale for share in (0.5, 0.25, 0.75)
    ]
    return all(is_free(system, q) for q in np.concatenate(between))


def _resampled(corners: Array) -> Array:
    """Points at equal shares of the length of a polyline, shape (SAMPLES, n)."""
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, s[-1], SAMPLES)
    return np.stack([np.interp(at, s, column) for column in corners.T], axis=1)
