r"""Proof that a motion keeps clear, between the samples too (conservative advancement).

A stretch of time is clear if the distance of every pair in its middle is more than any
of their points can move meanwhile. Where that is not so, the stretch is halved. A point
that hangs on the joints i moves by at most :math:`\sum_i r_i |\Delta q_i|` while the
joints move by :math:`|\Delta q_i|` at most, where r_i bounds its distance from the axis
of joint i (1 for sliding joints). A point of an obstacle that moves comes closer by
its largest speed times the time meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray, array_or_nan
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance, whole, wrong
from tominpmp.collision import CollisionChecker
from tominpmp.exceptions import ProblemError
from tominpmp.trajectory import Trajectory
from tominpmp.verification.link_displacement import LinkDisplacement, link_balls
from tominpmp.verification.polynomials import Pieces

# Stretches looked at before the proof is given up.
MAX_STRETCHES = 20_000
# Parts into which a stretch is cut that is not proved.
PARTS = 3


@dataclass(frozen=True)
class ClearanceProof:
    """What is proved about the clearance of a motion, at all times.

    Attributes:
        proved: Whether every pair keeps the required distance at every time.
        bound: Distance that every pair is proved to keep [m]; minus infinity where a
            contact was found or the proof was given up, infinite without pairs.
        distance: Smallest distance that was measured [m], at the tightest place.
        pair: Names of the pair there; None without pairs.
        time: When that is [s].
        contact: Whether a distance less than the required one was measured.
        stretches: How many stretches of time were looked at.
    """

    proved: bool
    bound: float
    distance: float
    pair: tuple[str, str] | None
    time: float
    contact: bool
    stretches: int

    def __bool__(self) -> bool:
        """Whether the clearance is proved."""
        return self.proved

    @property
    def message(self) -> str:
        """The outcome in a sentence."""
        if self.pair is None:
            return "There is nothing to collide with."
        place = (
            f"the tightest place is {' and '.join(self.pair)}, {self.distance:.4g} m "
            f"apart at {self.time:.3f} s"
        )
        if self.proved:
            return f"Clear by {self.bound:.4g} m at all times; {place}."
        if self.contact:
            return f"Not clear: {place}."
        return f"Neither proved nor disproved in {self.stretches} stretches; {place}."


@on_one_thread
def prove_clearance(
    checker: CollisionChecker,
    trajectory: Trajectory,
    margin: float | Array = 0.0,
    *,
    slack: float = 1e-4,
    deviation: Array | None = None,
    max_stretches: int = MAX_STRETCHES,
) -> ClearanceProof:
    """Prove that all pairs keep a distance along a motion, or find where they do not.

    Args:
        checker: Distances of the pairs.
        trajectory: The motion.
        margin: Distance to keep [m], one for all pairs or by pair.
        slack: What the distance may lack to the margin [m]. Where a motion slides along
            at the margin, the proof needs stretches in which links move no farther.
        deviation: How far the motion that is meant may be from the trajectory, by
            joint, shape (n,) [rad or m]: that of a replay, say.
        max_stretches: Number of stretches after which the proof is given up.

    Returns:
        The proof, or where it failed. Where an obstacle is moved by a function of which
        no bounds on its speed are known, it rests on estimates of these.
    """
    expected = "a CollisionChecker: problem.checker"
    instance(checker, CollisionChecker, "checker", expected)
    instance(trajectory, Trajectory, "trajectory")
    pairs, n = len(checker.pairs), checker.robot.n
    if trajectory.n != n:
        raise ProblemError(
            f"trajectory moves {trajectory.n} joints, the robot has {n}", "trajectory"
        )
    margin = _lengths(margin, "margin", pairs)
    slack = float(_lengths(slack, "slack", None))
    if deviation is not None:
        deviation = _lengths(deviation, "deviation", n)
    max_stretches = whole(max_stretches, "max_stretches")
    if not checker.pairs:
        return ClearanceProof(True, np.inf, np.inf, None, 0.0, False, 0)
    least = np.broadcast_to(margin, (len(checker.pairs),)) - slack
    return _Prover(checker, trajectory, deviation).run(least, max_stretches)


def _lengths(value: object, name: str, count: int | None) -> Array:
    """Take finite numbers: one, or one for each of so many."""
    array = array_or_nan(value)
    if not np.all(np.isfinite(array)) or array.shape not in ((), (count,)):
        each = "" if count is None else f", or {count} of them"
        raise wrong(value, name, f"a finite number{each}")
    return array


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Stretches of pieces of the motion: piece, middle and half length in its s."""

    piece: IntArray
    middle: Array
    half: Array

    @property
    def size(self) -> int:
        return int(self.piece.size)

    def cut(self, chosen: BoolArray) -> _Stretches:
        """Cut some into parts."""
        places = (2.0 * np.arange(PARTS) + 1.0 - PARTS) / PARTS
        middle = self.middle[chosen, None] + self.half[chosen, None] * places
        return _Stretches(
            np.repeat(self.piece[chosen], PARTS),
            middle.ravel(),
            np.repeat(self.half[chosen] / PARTS, PARTS),
        )


class _Prover:
    def __init__(
        self, checker: CollisionChecker, trajectory: Trajectory, deviation: Array | None
    ) -> None:
        self.checker, robot = checker, checker.robot
        path = replace(trajectory, inverse_dynamics=None)  # its torques take time
        self.pieces = Pieces.of(lambda times: path(times).q, path.t)
        self.stray = np.zeros(robot.n) if deviation is None else np.abs(deviation)
        self.stray = self.stray + self._rounding(trajectory)
        self.reach = LinkDisplacement(robot, link_balls(checker))
        own = np.arange(len(checker.pairs)) >= checker.obstacle_pairs
        self.motion = self.reach.relative(checker.pairs, own)

    def _rounding(self, trajectory: Trajectory) -> Array:
        """What the polynomials may be off by."""
        return np.asarray(
            self.pieces.deviation * np.max(np.abs(trajectory.q), initial=0.0)
            + np.zeros(trajectory.n)
        )

    def run(self, least: Array, max_stretches: int) -> ClearanceProof:
        count = self.pieces.count
        todo = _Stretches(np.arange(count), np.zeros(count), np.ones(count))
        bound = room = np.inf
        contact = False
        time, seen = 0.0, 0
        while todo.size:
            seen += todo.size
            apart, moved = self._look(todo, least)
            spare = np.min(apart - least, axis=1)
            k = int(np.argmin(spare))
            if spare[k] < room:
                room = float(spare[k])
                time = float(self._time(todo, todo.middle)[k])
            sure = apart - moved
            unproved = ~np.all(sure >= least, axis=1)
            bound = min(bound, float(np.min(sure[~unproved], initial=np.inf)))
            contact = room < 0.0
            if contact or (unproved.any() and seen > max_stretches):
                bound = -np.inf
                break
            todo = todo.cut(unproved)
        # What was measured there may have been a bound that was good enough.
        at = np.clip(time, self.pieces.t[0], self.pieces.t[-1])
        instant = np.array([at])
        exact = self.checker.distances(self.pieces(instant), times=instant)[0]
        pair = int(np.argmin(exact - least))
        distance = float(exact[pair])
        return ClearanceProof(
            proved=bound > -np.inf,
            bound=bound,
            distance=distance,
            pair=self.checker.pairs[pair],
            time=time,
            contact=contact,
            stretches=seen,
        )

    def _look(self, todo: _Stretches, least: Array) -> tuple[Array, Array]:
        """Distances in the middles, and how far pairs can move towards each other.

        Returns:
            Shapes (m, pairs) each [m].
        """
        shifted = self.pieces.around(todo.piece, todo.middle, todo.half)
        q = shifted[:, :, 0]
        swing = np.sum(np.abs(shifted[:, :, 1:]), axis=2) + self.stray
        moved = self.motion.bound(q, swing)
        times = self._time(todo, todo.middle)
        if self.checker.moving:
            half = todo.half * 0.5 * np.diff(self.pieces.t)[todo.piece]
            begin = np.maximum(times - half, 0.0)
            speeds = self.checker.obstacle_speeds(begin, times + half)
            moved += speeds * half[:, None]
        # Beyond this, distances need not be known to prove all of the stretches.
        enough = least + np.max(moved, axis=0)
        return self.checker.distances(q, enough, times), moved

    def _time(self, todo: _Stretches, places: Array) -> Array:
        begin, end = self.pieces.t[todo.piece], self.pieces.t[todo.piece + 1]
        return np.asarray(begin + 0.5 * (end - begin) * (1.0 + places))
