"""Paths around obstacles: RRT-Connect with balanced trees, and shortcuts.

Two trees of configurations grow from both ends of a path until they meet (RRT-Connect,
Kuffner and LaValle, 2000). The smaller tree is always the one that grows (balanced
trees, Kuffner and LaValle, 2005): few ways lead out of a goal among obstacles, and if
the trees took turns, the tree in the open would use up all collision checks. For a
Fetch in cages and shelves, 25 of 25 searches found a path in 15 000 checks on average;
with trees that took turns, 10 of 25 did in 40 000.

In long searches every other branch keeps the orientation of the last link, to first
order. A hand between shelves can usually be drawn back without turning, but hardly any
random direction of the joints does that. Of 46 searches for a Fetch in cages and
shelves, all found a path within 80 000 checks; without such branches 43 did. Short
searches do without them, as their paths are longer.

Distances in the trees approximate times: slow joints have a larger weight.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from scipy.constants import golden_ratio

from tominpmp.arrays import Array, IntArray
from tominpmp.initial_guess.path import PLACES, RESOLUTION
from tominpmp.kinematics import FrameMotions, last_joint, units_of
from tominpmp.stopping import check
from tominpmp.transcription.problem_functions import PADDING, ProblemFunctions

# Longest branches of the trees [rad of a joint of median speed].
REACH = 0.75
# Number of random configurations towards which a tree grows at once, and of nodes next
# to which a failed search looks for the blocking bodies.
BATCH = 16
# Collision checks after which a search is long.
LONG = 12_000
# Spacing of collision checks on a shortcut, which cuts corners as far as the checks
# allow [rad].
FINE = 0.0125
# Most collision checks of the first search for a path, and of the shortening of a path.
CHECKS = 80_000
# Distances beyond both ends to which joints without narrow limits are sampled, in turn
# [rad]: most ways out of narrow ends are close to these.
MARGINS = (np.pi, 1.0)
# Number of shortcuts tried on a path; half of them are shortcuts of a single joint.
SHORTCUTS = 120
# Weight of the displacements of all joints in the length of a path, relative to the
# displacement of the slowest joint.
ALL_JOINTS = 0.05
# Distance at all places below which two paths, or two motions, are alike [rad].
NEAR = 0.3
# The search ends after TRIES consecutive tries without a new path, plus one per end. A
# try that finds no path at all counts FAILED times: more checks in one try find more
# paths than more tries do.
TRIES, FAILED = 4, 3


class _BudgetSpent(Exception):
    """Raised once the collision checks of a path are used up."""


@dataclass
class PathSearches:
    """Success of the searches for a path among the obstacles of a problem.

    Attributes:
        found: Whether a path is known.
        impasse: A clause on the first search without a path; empty once one is known.
        checks: Most collision checks of each search. They are doubled if none of
            several searches has found a path.
    """

    found: bool = False
    impasse: str = ""
    checks: int = CHECKS


def is_free(system: ProblemFunctions, q: Array) -> bool:
    """Whether configurations, shape (n,) or (m, n), keep the required clearance."""
    return all(_each_free(system, np.atleast_2d(q)))


def _each_free(system: ProblemFunctions, q: Array) -> Iterator[bool]:
    """Yield for configurations, shape (m, n), one after the other whether each is free.

    Convex pieces need not be checked, nor be known, if the convex hulls of the links of
    a single arm are clear.
    """
    checker = system.problem.checker
    hulls = system.clearance_rows is not None and checker.single_arm
    for rows in q[:, None] if hulls else [q]:
        if hulls and checker.hulls_clear(rows[0], PADDING):
            yield True
        elif (clearance := system.clearance) is None:
            yield from [True] * len(rows)
        else:
            yield from clearance.checker.each_free(rows, clearance.margin)


def sample_paths(
    system: ProblemFunctions,
    ends: Sequence[Array],
    rng: np.random.Generator,
    searches: PathSearches,
    *,
    known: Sequence[Array] = (),
) -> Iterator[Array]:
    """Distinct paths from the start of a problem to given free ends in turn.

    Homotopic paths lead to the same motion: on the Panda among shelves and tables their
    optima agreed to 0.1 % in all of 15 cases.

    Args:
        system: Start, limits and clearance.
        ends: Final configurations, each of shape (n,) [rad or m]; ends in collision
            are left out.
        rng: Random numbers; the paths depend only on them.
        searches: Success of the searches so far, which these ones update.
        known: Known free paths, each of shape (m, n); paths alike to them are left out.

    Yields:
        Corners of a path, shape (m, n). The search is lazy.

    Raises:
        Stop: If it is time to stop.
    """
    paths = list(known)
    searches.found |= bool(paths)
    searched = deque(q for q in ends if is_free(system, q))
    failures, most = 0, TRIES + len(searched)
    while searched and failures < most:
        seed = int(rng.integers(1, 2**31))
        path = sample_path(system, searched[0], seed, searches)
        failures += FAILED if path is None else 1
        searched.rotate(-1)
        if path is not None and len(path) == 2:
            searched.pop()  # a search finds no other path where the line is free
        if path is None or any(alike(system, path, other) for other in paths):
            continue
        failures = 0
        paths.append(path)
        yield path
    if not searches.found:
        searches.checks *= 2


def sample_path(
    system: ProblemFunctions,
    q_end: Array,
    seed: int,
    searches: PathSearches,
) -> Array | None:
    """A collision-free path, shortened.

    Args:
        system: Start, limits and clearance.
        q_end: Final configuration, shape (n,) [rad or m].
        seed: Seed of the random numbers.
        searches: Success of the searches so far, which this one updates.

    Returns:
        Corners, shape (m, n); None if no path was found.

    Raises:
        Stop: If it is time to stop.
    """
    q_start, rng = system.problem.q_start, np.random.default_rng(seed)
    if not (is_free(system, q_start) and is_free(system, q_end)):
        return None
    space = _Space(system, q_end, searches.checks)
    trees = [_Tree(end) for end in space.ends]
    try:
        path = _connected(space, trees, rng)
    except _BudgetSpent:
        if not searches.found:
            grown = [tree.q * space.unit for tree in trees]
            searches.impasse = searches.impasse or _impasse(system, grown)
        return None
    searches.found, searches.impasse = True, ""
    corners = _shortened(space, path, rng) * space.unit
    corners[0], corners[-1] = q_start, q_end
    return corners


class _Space:
    """The scaled joint space of a search, with a budget of collision checks.

    Args:
        system: Start, limits and clearance.
        q_end: Final configuration, shape (n,) [rad or m].
        checks: Number of collision checks after which :class:`_BudgetSpent` is raised.

    Attributes:
        unit: Displacement of each joint that has length 1, shape (n,): 1 rad, or the
            reach of the arm; less for joints slower than the median speed limit.
        ends: Both ends, shape (2, n), in these units.
        lower: Lower bounds of a batch of random configurations, shape (BATCH, n).
        upper: Upper bounds of the batch.
        budget: Collision checks that are left.
    """

    def __init__(self, system: ProblemFunctions, q_end: Array, checks: int) -> None:
        limits, scale = system.problem.robot.limits, system.step_scale
        pace = limits.velocity / scale
        finite = pace[np.isfinite(pace)]
        median = np.median(finite) if finite.size else 1.0
        self.unit = scale * np.minimum(pace / median, 1.0)
        self.ends = np.stack([system.problem.q_start, q_end]) / self.unit
        beyond = np.resize(MARGINS, BATCH)[:, None] * scale / self.unit
        low, high = limits.position_lower / self.unit, limits.position_upper / self.unit
        self.lower = np.maximum(low, self.ends.min(axis=0) - beyond)
        self.upper = np.minimum(high, self.ends.max(axis=0) + beyond)
        self._radian = scale / self.unit
        # A single joint can only follow the line: a few checks find what blocks it.
        self.budget = checks if system.n > 1 else checks // 100
        self._system, robot = system, system.problem.robot
        self._last = FrameMotions(robot, str(robot.model.names[last_joint(robot)]))

    def without_turning(self, points: Array, steps: Array) -> Array:
        """Parts of steps that keep the orientation of the last link, to first order.

        Args:
            points: Where the steps begin, shape (m, n).
            steps: The steps, shape (m, n).

        Returns:
            Shape (m, n); the steps of an arm of up to three joints, which can hardly
            move without turning its last link.
        """
        if self._system.n <= 3:
            return steps
        jacobians = self._last.jacobians(points * self.unit, local=True)
        turning = jacobians[:, 3:] * self.unit
        turned = np.einsum("kij,kj->ki", turning, steps)
        back = np.linalg.pinv(turning, rcond=1e-3)
        return np.asarray(steps - np.einsum("kji,ki->kj", back, turned))

    def each_free(self, points: Array) -> Iterator[bool]:
        """Yield for each point, shape (m, n), whether it is free.

        Raises:
            _BudgetSpent: If the collision checks are used up.
            Stop: If it is time to stop.
        """
        check()
        for free in _each_free(self._system, points * self.unit):
            self.budget -= 1
            if self.budget < 0:
                raise _BudgetSpent
            yield free

    def is_free_along(self, corners: Array, spacing: float = RESOLUTION) -> bool:
        """Whether a polyline, shape (m, n), is free; its first corner is not checked.

        Args:
            corners: The polyline.
            spacing: Spacing of the collision checks [rad].
        """
        steps = np.diff(corners, axis=0)
        lengths = np.linalg.norm(steps / (spacing * self._radian), axis=1)
        counts = lengths.astype(np.int64) + 1
        piece = np.repeat(np.arange(counts.size), counts)
        place = np.arange(piece.size) - np.repeat(np.cumsum(counts) - counts, counts)
        share = (place + 1.0) / counts[piece]
        points = corners[piece] + share[:, None] * steps[piece]
        # The last point is checked first, then points that lie apart, as the multiples
        # of the golden ratio do, modulo 1.
        shares = golden_ratio * np.arange(len(points)) % 1.0
        order = np.argsort(np.argsort(shares))
        return all(self.each_free(points[::-1][order]))


class _Tree:
    """A tree of free configurations."""

    def __init__(self, root: Array) -> None:
        self._q, self.parents = np.tile(root, (1024, 1)), [-1]

    def __len__(self) -> int:
        return len(self.parents)

    @property
    def q(self) -> Array:
        """The configurations, shape (nodes, n)."""
        return self._q[: len(self)]

    def add(self, q: Array, parent: int) -> int:
        """Add a configuration; returns its index."""
        if len(self) == len(self._q):
            self._q = np.concatenate([self._q, np.empty_like(self._q)])
        self._q[len(self)] = q
        self.parents.append(parent)
        return len(self) - 1

    def nearest(self, q: Array) -> IntArray:
        """Indices of the nodes nearest to given configurations, shape (m, n)."""
        nodes = self.q
        squares = np.einsum("ij,ij->i", nodes, nodes) - 2.0 * q @ nodes.T
        return np.asarray(np.argmin(squares, axis=1))

    def to_root(self, index: int) -> list[Array]:
        """Configurations from a node to the root."""
        branch = []
        while index >= 0:
            branch.append(self._q[index])
            index = self.parents[index]
        return branch


def _impasse(system: ProblemFunctions, trees: Sequence[Array]) -> str:
    """Why a search has found no path, in a clause.

    It names the joint with the least progress towards the other end, and the pairs that
    collide if this joint alone moves on.

    Args:
        system: Limits and clearance.
        trees: Configurations reached from the start and from the goal, which come
            first, shape (m, n) each [rad or m].
    """
    said = "no path around the obstacles was found"
    robot, clearance = system.problem.robot, system.clearance
    way = trees[1][0] - trees[0][0]
    signs = np.sign(way), -np.sign(way)
    made = [(tree - tree[0]) * sign for tree, sign in zip(trees, signs, strict=True)]
    most = np.array([rows.max(axis=0) for rows in made])
    shares = np.divide(most, np.abs(way), np.full_like(most, np.inf), where=way != 0.0)
    root, j = divmod(int(np.argmin(shares)), way.size)
    if clearance is None or shares[root, j] >= 1.0:
        return said
    checker, pairs = clearance.checker, Counter[str]()
    ahead = np.zeros((BATCH, way.size))
    ahead[:, j] = signs[root][j] * RESOLUTION * np.arange(1, BATCH + 1)
    for q in trees[root][np.argsort(made[root][:, j])[-BATCH:]]:
        free = list(takewhile(bool, checker.each_free(q + ahead, clearance.margin)))
        hit = checker.closest(q + ahead[len(free) % BATCH], clearance.margin)
        if len(free) < BATCH and hit is not None:
            pairs[hit.pair] += 1
    here, there = ("start", "goal")[:: 1 - 2 * root]
    unit = units_of(robot)[j]
    bodies = " or ".join(pair for pair, _ in pairs.most_common(2))
    before = f" before {bodies} collide; more clearance may open a way" if pairs else ""
    return (
        f"{said}: from the {here}, joint {robot.joint_names[j]!r} came no farther than "
        f"{most[root, j]:.2g} of {abs(way[j]):.3g} {unit} towards the {there}{before}"
    )


def _connected(
    space: _Space, trees: Sequence[_Tree], rng: np.random.Generator
) -> Array:
    """A path between both ends, shape (m, n), in units of the space.

    Args:
        space: The joint space.
        trees: A tree at each end, which grow.
        rng: Random numbers.

    Raises:
        _BudgetSpent: If the collision checks are used up.
    """
    short = space.budget - LONG
    if space.is_free_along(space.ends):
        return space.ends
    here, there = trees
    while True:
        if len(here) > len(there):
            here, there = there, here
        nodes = here.nearest(targets := rng.uniform(space.lower, space.upper))
        begin = here.q[nodes]
        step = targets - begin
        if space.budget < short:
            step[::2] = space.without_turning(begin[::2], step[::2])
        length = np.linalg.norm(step, axis=1)
        end = begin + np.minimum(1.0, REACH / length)[:, None] * step
        for k in np.flatnonzero(list(space.each_free(end))).tolist():
            if not space.is_free_along(np.stack([begin[k], end[k]])):
                continue
            node = here.add(end[k], int(nodes[k]))
            met = _extended(space, there, end[k])
            if met is not None:
                path = [*reversed(here.to_root(node)), *there.to_root(met)[1:]]
                forward = np.array_equal(path[0], space.ends[0])
                return np.array(path if forward else path[::-1])


def _extended(space: _Space, tree: _Tree, target: Array) -> int | None:
    """Extend a tree on a straight line to a configuration.

    Returns:
        The node at the configuration; None if the line is blocked.
    """
    node = int(tree.nearest(target[None])[0])
    while True:
        here = tree.q[node]
        length = float(np.linalg.norm(target - here))
        end = here + min(1.0, REACH / max(length, 1e-12)) * (target - here)
        if not space.is_free_along(np.stack([here, end])):
            return None
        node = tree.add(end, node)
        if length <= REACH:
            return node


def _length(corners: Array) -> float:
    """Length of a polyline: by its slowest joint, with a small weight of all joints."""
    steps = np.abs(np.diff(corners, axis=0))
    return float(np.sum(np.max(steps, axis=1)) + ALL_JOINTS * np.sum(steps))


def _shortened(space: _Space, path: Array, rng: np.random.Generator) -> Array:
    """Shortcuts of a path in all joints, or in one (Geraerts and Overmars, 2007)."""
    n = path.shape[1]
    space.budget = CHECKS
    try:
        for _ in range(SHORTCUTS):
            steps = np.max(np.abs(np.diff(path, axis=0)), axis=1)
            s = np.concatenate([[0.0], np.cumsum(steps)])
            at = np.sort(rng.uniform(0.0, s[-1], 2))
            joint = int(rng.integers(2 * n))
            begin, end = np.searchsorted(s, at)
            inner = path[begin:end]  # a shortcut that skips no corner gains nothing
            ends = np.stack([np.interp(at, s, column) for column in path.T], axis=1)
            former = np.concatenate([ends[:1], inner, ends[1:]])
            shorter = ends
            if joint < n:
                shorter = former.copy()
                shorter[1:-1, joint] = np.interp(s[begin:end], at, ends[:, joint])
            gain = _length(former) - _length(shorter)
            if gain > 1e-3 and space.is_free_along(shorter, FINE):
                path = np.concatenate([path[:begin], shorter, path[end:]])
        for k in range(len(path) - 2, 0, -1):
            if space.is_free_along(path[[k - 1, k + 1]], FINE):
                path = np.delete(path, k, axis=0)
    except _BudgetSpent:
        pass
    return path


def is_free_line(system: ProblemFunctions, begin: Array, end: Array) -> bool:
    """Whether the straight line between two configurations is free."""
    length = float(np.linalg.norm((end - begin) / system.step_scale))
    shares = np.linspace(0.0, 1.0, 2 + int(length / RESOLUTION))
    return is_free(system, begin + shares[:, None] * (end - begin))


def alike(system: ProblemFunctions, one: Array, other: Array) -> bool:
    """Whether two paths are close to each other, or homotopic by a straight shift.

    Args:
        system: Clearance and scales.
        one: Corners, shape (m, n).
        other: Corners, shape (k, n).

    Returns:
        Whether they are alike. Homotopy is only tested by a straight shift between
        points at equal shares of the lengths of the paths.
    """
    one, other = (_resampled(path / system.step_scale) for path in (one, other))
    if np.max(np.abs(one - other)) < NEAR:
        return True
    if np.max(np.abs(one[-1] - other[-1])) > NEAR:
        return False
    between = [
        (one + share * (other - one)) * system.step_scale for share in (0.5, 0.25, 0.75)
    ]
    return all(_each_free(system, np.concatenate(between)))


def _resampled(corners: Array) -> Array:
    """Points at equal shares of the length of a polyline, shape (PLACES, n)."""
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, s[-1], PLACES)
    return np.stack([np.interp(at, s, column) for column in corners.T], axis=1)
