"""Distances of pairs at many configurations, exact only where bounds do not suffice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.checks import JOINTS, array
from tominpmp.collision.broad import BroadPhase, Joints, Pairs
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import JointPlacements, MovingObstacles

if TYPE_CHECKING:
    from tominpmp.collision.shapes import Body
    from tominpmp.robot.robot import Robot

# Overlaps up to this size are rounding [m].
ROUNDING = 1e-6
# Number of configurations that are processed at once, which limits the memory.
CHUNK = 1024


class Derivatives(NamedTuple):
    """Derivatives of distances.

    Attributes:
        gradients: Derivatives by the configuration, shape (k, n) [m/rad or m/m].
        rates: Derivatives by time, due to moving obstacles, shape (k,) [m/s].
    """

    gradients: Array
    rates: Array


class PairDistances:
    """Collision pairs and their distances, by a broad and a narrow phase.

    Attributes:
        robot: The robot.
        obstacles: Placements of moving obstacles, which only a subclass may have.
    """

    def __init__(self, robot: Robot, watched: tuple[Sequence[Body], Pairs]) -> None:
        self.robot, self.watched = robot, watched
        self.obstacles = MovingObstacles((), robot.model.njoints)

    @cached_property
    def watched(self) -> tuple[Sequence[Body], Pairs]:
        """The bodies, and the collision pairs of bodies."""
        raise NotImplementedError

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names (link, other) of the pairs; pairs with obstacles come first.

        A link has a separate pair for each of its convex pieces.
        """
        bodies, pairs = self.watched
        return tuple((bodies[i].name, bodies[k].name) for i, k in pairs.tolist())

    @cached_property
    def placements(self) -> JointPlacements:
        """Forward kinematics of the robot."""
        return JointPlacements(self.robot.model)

    @cached_property
    def broad(self) -> BroadPhase:
        """Broad phase: bounds from balls and boxes."""
        return BroadPhase(*self.watched)

    @cached_property
    def narrow(self) -> NarrowPhase:
        """Narrow phase: exact distances."""
        return NarrowPhase(self.robot.model, *self.watched)

    @cached_property
    def moving_pairs(self) -> BoolArray:
        """Whether each pair has a moving obstacle, shape (pairs,)."""
        return np.asarray(self.broad.joint[self.broad.second] >= self.obstacles.first)

    @cached_property
    def _moves(self) -> BoolArray:
        """Whether coordinates of the model change distances, shape (pairs, nv).

        A coordinate changes the distance of a pair if it moves exactly one of its
        bodies.
        """
        one = self.placements.moves[self._model_joint(self.broad.first)]
        other = self.placements.moves[self._model_joint(self.broad.second)]
        return np.asarray(one != other)

    def _model_joint(self, bodies: IntArray) -> IntArray:
        """Joints of the model that carry bodies; 0, the world, for obstacles."""
        joint = self.broad.joint[bodies]
        return np.where(joint < self.obstacles.first, joint, 0)

    def _place(self, rows: Array, times: Array) -> Joints:
        """Placements joint_to_world at configurations of the model and times [s].

        The placements of moving obstacles follow those of the joints.
        """
        joints = self.placements.joints(rows)
        if not self.obstacles.count:
            return joints
        both = zip(joints, self.obstacles.placements(times), strict=True)
        R, t = (np.concatenate(parts, axis=1) for parts in both)
        return R, t

    def distances(
        self,
        q: Array,
        cutoff: float | Array = np.inf,
        times: Array | None = None,
    ) -> Array:
        """Signed distances at configurations.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            cutoff: Distance beyond which a lower bound suffices [m], a number for all
                pairs or an array, shape (pairs,); infinite for exact distances only.
            times: Times [s], shape (m,), for moving obstacles; None for the start.

        Returns:
            Distances [m], shape (m, pairs). Distances below the cutoff are exact; other
            distances may be lower bounds, which are not below the cutoff.
        """
        q = array(q, "q", (None, self.robot.n), JOINTS)
        rows, out = self.robot.expand(q), np.empty((q.shape[0], len(self.pairs)))
        times = _or_start(times, q)
        limit = self._by_pair(cutoff, "cutoff")
        if np.all(np.isposinf(limit)):  # bounds would be computed for nothing
            instant, pair = np.indices(out.shape).reshape(2, -1)
            return self._exact(rows, instant, pair, times).reshape(out.shape)
        limit = np.maximum(limit, 0.0)  # bounds do not hold for depths
        for begin in range(0, len(q), CHUNK):
            part = slice(begin, begin + CHUNK)
            out[part] = self._cut_off(rows[part], limit, times[part])
        return out

    def _by_pair(self, value: float | Array, name: str) -> Array:
        """A caller's distance for all pairs, or distances by pair, shape (pairs,)."""
        each = value if np.ndim(value) else [value] * len(self.pairs)
        return array(each, name, (len(self.pairs),), "distances of the pairs [m]")

    def _cut_off(self, rows: Array, limit: Array, times: Array) -> Array:
        """Distances, shape (m, pairs) [m], exact below the limits of pairs."""
        placed = self._place(rows, times)
        lower, instant, pair = self.broad.below(placed, limit)
        if not instant.size:
            return lower
        bound = lower[instant, pair]
        found = self._measured(rows, placed, instant, pair, limit[pair], times)
        near = found < limit[pair]
        lower[instant, pair] = np.where(near, found, np.maximum(found, bound))
        return lower

    def lower_bounds(self, q: Array, times: Array) -> Array:
        """Lower bounds of all distances, shape (m, pairs) [m]; see ``distances``."""
        return self.broad.by_balls(self._place(self.robot.expand(q), times))

    def measured(
        self,
        q: Array,
        instants: IntArray,
        pairs: IntArray,
        enough: Array,
        times: Array | None = None,
    ) -> Array:
        """Signed distances of single pairs at single configurations.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each distance, shape (k,).
            pairs: Index of the pair of each distance, shape (k,).
            enough: Distances above which a lower bound suffices, shape (k,) [m].
            times: Times [s], shape (m,), for moving obstacles; None for the start.

        Returns:
            Distances, shape (k,) [m]; exact if below ``enough``.
        """
        used, instants = np.unique(instants, return_inverse=True)
        rows, times = self.robot.expand(q[used]), _or_start(times, q)[used]
        placed = self._place(rows, times)
        return self._measured(rows, placed, instants, pairs, enough, times)

    def _measured(
        self,
        rows: Array,
        placed: Joints,
        instant: IntArray,
        pair: IntArray,
        enough: Array,
        times: Array,
    ) -> Array:
        """Distances of single pairs, (k,) [m]; see ``measured``."""
        out = self.broad.by_covers(placed, instant, pair)
        # Bounds do not hold for depths.
        near = np.flatnonzero(out < np.maximum(enough, 0.0))
        out[near] = self._exact(rows, instant[near], pair[near], times)
        return out

    def _exact(
        self, rows: Array, instant: IntArray, pair: IntArray, times: Array
    ) -> Array:
        """Exact distances of single pairs at configurations of the model, (k,) [m]."""
        out = np.empty(instant.size)
        for narrow, chosen, pairs in self._placed(rows, instant, pair, times):
            out[chosen] = narrow.distances(pairs)
        return out

    def _placed(
        self, rows: Array, instant: IntArray, pair: IntArray, times: Array
    ) -> Iterator[tuple[NarrowPhase, IntArray, list[int]]]:
        """Place the bodies at one configuration after the other.

        Yields:
            The narrow phase whose bodies are placed, indices into ``instant`` and
            ``pair`` of the queries at the configuration, and their pairs.
        """
        # Another thread that sets up the pairs at the same time replaces the property.
        narrow = self.narrow
        order = np.argsort(instant, kind="stable")
        starts = np.flatnonzero(np.diff(instant[order], prepend=-1))
        groups = instant[order[starts]]
        R, p = self.obstacles.placements(times[groups])
        ends = [*starts[1:].tolist(), order.size]
        for k, (begin, end) in enumerate(zip(starts.tolist(), ends, strict=False)):
            narrow.place(rows[groups[k]], R[k], p[k])
            chosen = order[begin:end]
            yield narrow, chosen, pair[chosen].tolist()

    def derivatives_at(
        self,
        q: Array,
        instants: IntArray,
        pairs: IntArray,
        times: Array | None = None,
    ) -> Derivatives:
        r"""Derivatives of some distances by configuration and by time.

        With the witness points p1, p2 and the unit normal n from the first body to the
        second, :math:`d_q = n^T (J_2(p_2) - J_1(p_1))`. The normal is defined in
        penetration and at contact, too, so that the gradient is finite. The gradient is
        zero if no joint changes the distance: a planar arm that overlaps a box flatter
        than itself could leave the box only perpendicular to its plane of motion. For a
        moving obstacle, whose point p2 has the velocity v, :math:`d_t = n^T v`.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each gradient, shape (k,).
            pairs: Index of the pair of each gradient, shape (k,).
            times: Times [s], shape (m,), for moving obstacles; None for the start.

        Returns:
            The derivatives.
        """
        rows, times = self.robot.expand(q), _or_start(times, q)
        normal, *points = self.witnesses(q, instants, pairs, times)
        placed = self.placements.joints(rows)
        out = np.zeros((len(pairs), rows.shape[1]))
        for bodies, point, sign in (
            (self.broad.first, points[0], -1.0),
            (self.broad.second, points[1], 1.0),
        ):
            joint = self._model_joint(bodies[pairs])
            args = placed, instants, joint, point, normal
            out += sign * self.placements.jacobian_rows(*args)
        other = self.broad.joint[self.broad.second[pairs]]
        rates = self.obstacles.approach(other, times[instants], points[1], normal)
        return Derivatives(self.robot.reduce_tangent(out), rates)

    def witnesses(
        self, q: Array, instants: IntArray, pairs: IntArray, times: Array
    ) -> Array:
        """Normals and witness points of some pairs.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each pair, shape (k,).
            pairs: Indices of the pairs, shape (k,).
            times: Times [s], shape (m,), for moving obstacles.

        Returns:
            Unit normals from the first body to the second, along which the distance
            grows, and the witness points on both bodies [m], in the world, shape
            (3, k, 3).
        """
        rows, found = self.robot.expand(q), np.empty((3, len(pairs), 3))
        for narrow, chosen, some in self._placed(rows, instants, pairs, times):
            found[:, chosen] = narrow.witnesses(some)
        return found

    def decrease(
        self,
        q: Array,
        swing: Array,
        begin: Array,
        end: Array,
        pairs: IntArray | None = None,
    ) -> Array:
        """Bounds on the decrease of distances within spans of time.

        Coordinates that move both bodies of a pair do not change their distance.

        Args:
            q: Configurations in the middle of the spans, shape (m, n) [rad or m].
            swing: Largest deviations of joints from there within the spans, (m, n).
            begin: Beginnings of the spans [s], shape (m,).
            end: Ends of the spans [s], shape (m,).
            pairs: Indices of the pairs, shape (k,); None for all pairs.

        Returns:
            Bounds, shape (m, k) [m].
        """
        pairs = np.arange(len(self.pairs)) if pairs is None else pairs
        broad, robot = self.broad, self.robot
        half = swing @ np.abs(robot.expand_tangent(np.eye(robot.n)))
        ends = np.stack([broad.first[pairs], broad.second[pairs]])
        still = self._model_joint(ends) == 0
        ends[still] = np.max(ends[still], initial=0)  # one body represents all at rest
        used, place = np.unique(ends, return_inverse=True)
        first, second = place.reshape(ends.shape)
        balls = self._model_joint(used), broad.centre[used], broad.radius[used]
        moved = self.placements.displacements(robot.expand(q), half, *balls)
        out, moves = np.zeros((len(q), pairs.size)), self._moves[pairs]
        for column in np.flatnonzero(moves.any(axis=0)).tolist():
            some, shift = np.flatnonzero(moves[:, column]), moved[:, :, column]
            out[:, some] += shift[:, first[some]] + shift[:, second[some]]
        if self.obstacles.count:
            speeds = self.obstacle_speeds(begin, end)[:, pairs]
            out += 0.5 * (end - begin)[:, None] * speeds
        return out

    def obstacle_speeds(self, begin: Array, end: Array) -> Array:
        """Bounds on the speeds of all points of the second body of each pair.

        Args:
            begin: Beginnings of spans of time [s], shape (m,).
            end: Ends of the spans [s], shape (m,).

        Returns:
            Bounds, shape (m, pairs) [m/s]; zero for links and for obstacles at rest.
        """
        body, carrier = self.broad.second, self.broad.joint[self.broad.second]
        return self.obstacles.speeds(carrier, self.broad.farthest[body], begin, end)


def _or_start(times: Array | None, q: Array) -> Array:
    """Times of configurations [s], shape (m,): the given times, or the start."""
    return np.zeros(len(q)) if times is None else times
