"""Distances of pairs at many configurations: bounds where they suffice, else exact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray
from tominpmp.checks import JOINTS, array
from tominpmp.collision.broad import BroadPhase, Joints, Pairs
from tominpmp.collision.narrow import NarrowPhase
from tominpmp.collision.placements import MovingObstacles, Placements

if TYPE_CHECKING:
    from tominpmp.collision.shapes import Body
    from tominpmp.robot.robot import Robot

# Configurations whose distances are computed at once, which limits the memory.
CHUNK = 1024


class Derivatives(NamedTuple):
    """Derivatives of distances.

    Attributes:
        gradients: Derivatives by the configuration, shape (k, n) [m/rad or m/m].
        rates: Derivatives by time, where obstacles move, shape (k,) [m/s].
    """

    gradients: Array
    rates: Array


class PairDistances:
    """Collision pairs, and the steps from coarse bounds to their exact distances.

    Attributes:
        robot: The robot.
        obstacles: Moving obstacles.
    """

    def __init__(
        self,
        robot: Robot,
        obstacles: MovingObstacles | None = None,
        watched: tuple[Sequence[Body], Pairs] | None = None,
    ) -> None:
        """Set up bodies and collision pairs, unless a subclass provides them."""
        self.robot = robot
        self.obstacles = obstacles or MovingObstacles((), robot.model.njoints)
        if watched is not None:
            self.watched = watched

    @cached_property
    def watched(self) -> tuple[Sequence[Body], Pairs]:
        """The bodies, and the pairs of them."""
        raise NotImplementedError

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names (link, other) of the pairs; pairs with obstacles come first.

        A link has a pair for each of its convex pieces.
        """
        bodies, pairs = self.watched
        return tuple((bodies[i].name, bodies[k].name) for i, k in pairs.tolist())

    @cached_property
    def placements(self) -> Placements:
        """Forward kinematics."""
        return Placements(self.robot.model)

    @cached_property
    def broad(self) -> BroadPhase:
        """Bounds from balls and boxes."""
        return BroadPhase(*self.watched)

    @cached_property
    def narrow(self) -> NarrowPhase:
        """Exact distances."""
        return NarrowPhase(self.robot.model, *self.watched, self.obstacles)

    @cached_property
    def moving_pairs(self) -> BoolArray:
        """Whether each pair has a moving obstacle, shape (pairs,)."""
        return np.asarray(self.broad.joint[self.broad.second] >= self.obstacles.first)

    @cached_property
    def _moves(self) -> BoolArray:
        """Whether coordinates of the model change the distance of each pair.

        They do if they move one of its bodies and not the other, shape (pairs, nv).
        """
        one, other = (
            self.placements.moves[self._model_joint(bodies)]
            for bodies in (self.broad.first, self.broad.second)
        )
        return np.asarray(one != other)

    def _model_joint(self, bodies: IntArray) -> IntArray:
        """Joints of the model that carry bodies; 0, the world, for obstacles."""
        joint = self.broad.joint[bodies]
        return np.where(joint < self.obstacles.first, joint, 0)

    def _place(self, rows: Array, times: Array) -> Joints:
        """Placements joint_to_world at configurations of the model, and times [s].

        Placements of moving obstacles are appended.
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
            cutoff: Distance beyond which a lower bound is enough [m], one for all pairs
                or by pair, shape (pairs,); infinite for exact distances throughout.
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            Distances [m], shape (m, number of pairs). Distances below the cutoff are
            exact; others may be lower bounds, which are not below the cutoff either.
        """
        q = array(q, "q", (None, self.robot.n), JOINTS)
        rows, out = self.robot.expand(q), np.empty((q.shape[0], len(self.pairs)))
        times = _or_start(times, q)
        if np.all(np.isposinf(cutoff)):  # no bound saves anything
            instant, pair = np.indices(out.shape).reshape(2, -1)
            return self._exact(rows, instant, pair, times).reshape(out.shape)
        limit = np.broadcast_to(np.asarray(cutoff, np.float64), out.shape[1:])
        limit = np.maximum(limit, 0.0)  # bounds say nothing about depths
        for begin in range(0, len(q), CHUNK):
            part = slice(begin, begin + CHUNK)
            out[part] = self._cut_off(rows[part], limit, times[part])
        return out

    def _cut_off(self, rows: Array, limit: Array, times: Array) -> Array:
        """Distances at configurations of the model, exact below the limits of pairs."""
        placed = self._place(rows, times)
        lower, instant, pair = self.broad.near(placed, limit)
        if not instant.size:
            return lower
        bound = lower[instant, pair]
        found = self._measured(rows, placed, instant, pair, limit[pair], times)
        near = found < limit[pair]
        lower[instant, pair] = np.where(near, found, np.maximum(found, bound))
        return lower

    def lower_bounds(self, q: Array, times: Array | None = None) -> Array:
        """Lower bounds of all distances, without measuring any; see ``distances``."""
        placed = self._place(self.robot.expand(q), _or_start(times, q))
        return self.broad.by_balls(placed)

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
            pairs: Index of its pair, shape (k,).
            enough: Distances above which a lower bound suffices, shape (k,) [m].
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            Shape (k,) [m]; exact where below ``enough``.
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
        """Distances of single pairs at configurations of the model, once placed."""
        out = self.broad.by_covers(placed, instant, pair)
        # Bounds say nothing about depths.
        near = np.flatnonzero(out < np.maximum(enough, 0.0))
        out[near] = self._exact(rows, instant[near], pair[near], times)
        return out

    def _exact(
        self, rows: Array, instant: IntArray, pair: IntArray, times: Array
    ) -> Array:
        """Exact distances of single pairs at configurations of the model."""
        out = np.empty(instant.size)
        for chosen, pairs in self._placed(rows, instant, pair, times):
            out[chosen] = self.narrow.distances(pairs)
        return out

    def _placed(
        self, rows: Array, instant: IntArray, pair: IntArray, times: Array
    ) -> Iterator[tuple[IntArray, list[int]]]:
        """Place the bodies at one configuration after the other.

        Yields:
            Indices of the instants with the configuration, and their pairs.
        """
        order = np.argsort(instant, kind="stable")
        starts = np.flatnonzero(np.diff(instant[order], prepend=-1))
        groups = instant[order[starts]]
        when = times[groups]
        R, p = self.obstacles.placements(when)
        ends = [*starts[1:].tolist(), order.size]
        for k, (begin, end) in enumerate(zip(starts.tolist(), ends, strict=False)):
            self.narrow.place(rows[groups[k]], float(when[k]), (R[k], p[k]))
            chosen = order[begin:end]
            yield chosen, pair[chosen].tolist()

    def derivatives_at(
        self,
        q: Array,
        instants: IntArray,
        pairs: IntArray,
        times: Array | None = None,
    ) -> Derivatives:
        r"""Derivatives of some distances by configuration and by time.

        With the witness points p1, p2 and the unit normal n from the first body to the
        second, :math:`d_q = n^T (J_2(p_2) - J_1(p_1))`. In penetration and at contact
        the normal stays defined, so that the gradient is finite there too. It is zero
        where no joint changes the distance: a planar arm that overlaps a box flatter
        than the arm could leave it only across its plane, in which it cannot move.
        Where the obstacle moves, its point p2 has a velocity v of its own, and
        :math:`d_t = n^T v`.

        Args:
            q: Configurations, shape (m, n) [rad or m].
            instants: Index of the configuration of each gradient, shape (k,).
            pairs: Index of its pair, shape (k,).
            times: Times [s], shape (m,), for obstacles that move; None for the start.

        Returns:
            The derivatives.
        """
        rows, times = self.robot.expand(q), _or_start(times, q)
        normal, *points = self.witnesses(q, instants, pairs, times)
        R, t = self.placements.joints(rows)
        placed = R[instants], t[instants]
        out = np.zeros((len(pairs), rows.shape[1]))
        for bodies, point, sign in (
            (self.broad.first, points[0], -1.0),
            (self.broad.second, points[1], 1.0),
        ):
            joint = self._model_joint(bodies[pairs])
            out += sign * self.placements.jacobian_rows(placed, joint, point, normal)
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
            times: Times [s], shape (m,), for obstacles that move.

        Returns:
            Unit normals from the first body to the second, along which the distance
            grows, and the points on both [m], in the world, shape (3, k, 3).
        """
        rows, found = self.robot.expand(q), np.empty((3, len(pairs), 3))
        for chosen, some in self._placed(rows, instants, pairs, times):
            found[:, chosen] = self.narrow.witnesses(some)
        return found

    def closing(
        self,
        q: Array,
        swing: Array,
        begin: Array,
        end: Array,
        pairs: IntArray | None = None,
    ) -> Array:
        """Bounds on the decrease of distances within stretches of time.

        Coordinates that move both bodies of a pair alike do not bring them closer.

        Args:
            q: Configurations in the middles of the stretches, shape (m, n) [rad or m].
            swing: Largest deviations of joints from there in the stretch, (m, n).
            begin: Beginnings of the stretches [s], shape (m,).
            end: Ends of the stretches [s], shape (m,).
            pairs: Indices of the pairs, shape (k,); None for all.

        Returns:
            Shape (m, k) [m].
        """
        pairs = np.arange(len(self.pairs)) if pairs is None else pairs
        broad, robot = self.broad, self.robot
        half = swing @ np.abs(robot.expand_tangent(np.eye(robot.n)))
        ends = np.stack([broad.first[pairs], broad.second[pairs]])
        still = self._model_joint(ends) == 0
        ends[still] = np.max(ends[still], initial=0)  # one represents all
        used, place = np.unique(ends, return_inverse=True)
        first, second = place.reshape(ends.shape)
        balls = self._model_joint(used), broad.centre[used], broad.radius[used]
        moved = self.placements.displacements(robot.expand(q), half, *balls)
        out, apart = np.zeros((len(q), pairs.size)), self._moves[pairs]
        for column in np.flatnonzero(apart.any(axis=0)).tolist():
            some, ways = np.flatnonzero(apart[:, column]), moved[:, :, column]
            out[:, some] += ways[:, first[some]] + ways[:, second[some]]
        if self.obstacles.count:
            speeds = self.obstacle_speeds(begin, end)[:, pairs]
            out += 0.5 * (end - begin)[:, None] * speeds
        return out

    def obstacle_speeds(self, begin: Array, end: Array) -> Array:
        """Bounds on the speed of all points of the other body of each pair.

        Args:
            begin: Beginnings of stretches of time [s], shape (m,).
            end: Ends of the stretches [s], shape (m,).

        Returns:
            Shape (m, pairs) [m/s]; zero for links, and for obstacles at rest.
        """
        out = np.zeros((begin.size, self.broad.first.size))
        moving = np.flatnonzero(self.moving_pairs)
        if moving.size:
            linear, angular = self.obstacles.speeds(begin, end)
            body = self.broad.second[moving]
            number = self.broad.joint[body] - self.obstacles.first
            farthest = self.broad.farthest[body]
            out[:, moving] = linear[:, number] + angular[:, number] * farthest
        return out


def _or_start(times: Array | None, q: Array) -> Array:
    """Times of configurations [s], shape (m,): the start, unless they are given."""
    return np.zeros(len(q)) if times is None else times
