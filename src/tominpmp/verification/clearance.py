r"""Proof that a motion keeps clear, between the samples too (conservative advancement).

A stretch of time is clear if the distance of every pair in its middle is more than any
of their points can move meanwhile. Where that is not so, the stretch is halved. A point
that hangs on the joints i moves by at most :math:`\sum_i r_i |\Delta q_i|` while the
joints move by :math:`|\Delta q_i|` at most, where r_i bounds its distance from the axis
of joint i (1 for sliding joints). A point of an obstacle that moves comes closer by
its largest speed times the time meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, BoolArray, IntArray, array_or_nan
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance, whole, wrong
from tominpmp.collision import CollisionChecker
from tominpmp.collision.contact import Contact
from tominpmp.exceptions import ProblemError
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem import Problem
from tominpmp.verification.link_displacement import LinkDisplacement, link_balls
from tominpmp.verification.polynomials import Pieces
from tominpmp.verification.stages import stages_of

# Stretches looked at before the proof is given up.
MAX_STRETCHES = 20_000
# Of more kinds of pairs than this the least and the largest margin are named.
MOST_KINDS = 3
# What pairs are called.
KINDS = ("links and obstacles", "links of the robot")
# Parts into which a stretch is cut that is not proved.
PARTS = 3


class Kept(NamedTuple):
    """A distance that pairs of one kind and margin keep at all times.

    Attributes:
        pairs: Which pairs they are, in words.
        margin: Distance that is asked of them [m].
        bound: What is proved of them [m], no less than that and what it may lack.
    """

    pairs: str
    margin: float
    bound: float

    def words(self, pairs: str) -> str:
        """What is proved of them, by a name.

        Args:
            pairs: The name.
        """
        # No more than is asked, nor than is proved: the last digit is rounded down.
        least = math.floor(1e4 * min(self.margin, self.bound) * (1.0 + 1e-12)) / 1e4
        apart = f"at least {least:.4f} m apart"
        if least <= 0.0:
            lack = math.ceil(-1e5 * self.bound) / 1e5
            apart = "apart" if self.bound > 0.0 else f"clear but for {lack:.5f} m"
        return f"{pairs} {apart} ({_asked(self.margin)})"


@dataclass(frozen=True)
class ClearanceProof:
    """What is proved about the clearance of a motion, at all times.

    Attributes:
        proved: Whether every pair keeps its margin at every time.
        kept: What pairs are proved to keep, those of one margin together; empty without
            a proof.
        nearest: The pair and its distance at the tightest place that was measured, that
            with the least room to its margin; None without pairs.
        time: When that is [s].
        contact: Whether a distance less than the required one was measured.
        stretches: How many stretches of time were looked at.
    """

    proved: bool
    kept: tuple[Kept, ...]
    nearest: Contact | None
    time: float
    contact: bool
    stretches: int

    def __bool__(self) -> bool:
        """Whether the clearance is proved."""
        return self.proved

    @property
    def bound(self) -> float:
        """Distance that every pair is proved to keep [m].

        It is that of all pairs, whatever their margins. Minus infinity where a contact
        was found or the proof was given up, infinite without pairs.
        """
        if not self.proved:
            return -math.inf
        return min((item.bound for item in self.kept), default=math.inf)

    @property
    def distance(self) -> float:
        """Distance at the tightest place that was measured [m]."""
        return math.inf if self.nearest is None else self.nearest.distance

    @property
    def pair(self) -> tuple[str, str] | None:
        """Names of the pair there; None without pairs."""
        return None if self.nearest is None else self.nearest[:2]

    @property
    def room(self) -> float:
        """Distance there beyond the margin [m]."""
        return math.inf if self.nearest is None else -self.nearest.lack

    @property
    def message(self) -> str:
        """The outcome in a sentence."""
        if self.nearest is None:
            return "There is nothing to collide with."
        near, asked = self.nearest, _asked(self.nearest.margin)
        apart = f"{near.distance:{'.4f' if self.proved else '.4g'}} m"
        place = f"{near.pair}, {apart} at {self.time:.3f} s"
        if self.contact:
            return f"Not clear: too near are {place} ({asked})."
        if self.proved:
            seen = "the nearest approach seen is"
            if len({item.margin for item in self.kept}) > 1:
                seen = "the least room is seen between"
            return f"Proved: {self._statement}; {seen} {place}."
        return (
            f"Neither proved nor disproved in {self.stretches} stretches; the least "
            f"room is seen between {place} ({asked})."
        )

    @property
    def _statement(self) -> str:
        """What is proved, for which pairs."""
        margins = [item.margin for item in self.kept]
        if len(margins) > MOST_KINDS:
            return (
                "every pair keeps the margin asked of it at all times, "
                f"{min(margins):.4g} to {max(margins):.4g} m"
            )
        told = [item.words(f"{item.pairs} stay") for item in self.kept]
        if len(set(margins)) == 1:
            tightest = min(self.kept, key=lambda item: item.bound)
            told = [tightest.words("every pair stays")]
        return f"{', '.join(told)} at all times"


def _kept(found: Iterable[Kept]) -> tuple[Kept, ...]:
    """What pairs keep, those of one kind and margin together."""
    least: dict[tuple[str, float], float] = {}
    for pairs, margin, bound in found:
        least[pairs, margin] = min(bound, least.get((pairs, margin), math.inf))
    return tuple(Kept(*kind, bound) for kind, bound in sorted(least.items()))


def _asked(margin: float) -> str:
    return f"margin asked {margin:.4g} m" if margin != 0.0 else "no margin asked"


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
        return ClearanceProof(True, (), None, 0.0, False, 0)
    margins = np.broadcast_to(margin, (len(checker.pairs),))
    span = 0.0, trajectory.duration
    prover = _Prover(checker, trajectory, span, deviation)
    return prover.run(margins, slack, int(max_stretches))


def clearance_of(
    problem: Problem, trajectory: Trajectory, deviation: Array | None
) -> ClearanceProof:
    """Prove that a motion keeps the margins of a problem, on each of its segments.

    Args:
        problem: The problem.
        trajectory: The motion.
        deviation: See :func:`prove_clearance`.
    """
    proofs = []
    for stage in stages_of(problem, trajectory):
        checker = stage.problem.checker
        if checker.pairs and stage.end > stage.begin:
            prover = _Prover(checker, trajectory, (stage.begin, stage.end), deviation)
            proofs.append(prover.run(stage.problem.margins, 0.0, MAX_STRETCHES))
    if not proofs:
        return ClearanceProof(True, (), None, 0.0, False, 0)
    worst = min(proofs, key=lambda item: (item.proved, item.room))
    return replace(
        worst,
        kept=_kept(kept for item in proofs for kept in item.kept) if worst else (),
        stretches=sum(item.stretches for item in proofs),
    )


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
        self,
        checker: CollisionChecker,
        trajectory: Trajectory,
        span: tuple[float, float],
        deviation: Array | None,
    ) -> None:
        self.checker, robot = checker, checker.robot
        path = replace(trajectory, inverse_dynamics=None)  # its torques take time
        inside = path.t[(path.t > span[0]) & (path.t < span[1])]
        times = np.concatenate([span[:1], inside, span[1:]])
        self.pieces = Pieces.of(lambda times: path(times).q, times)
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

    def run(self, margins: Array, slack: float, max_stretches: int) -> ClearanceProof:
        count, least = self.pieces.count, margins - slack
        todo = _Stretches(np.arange(count), np.zeros(count), np.ones(count))
        bounds = np.full(margins.size, np.inf)
        room, contact, proved = np.inf, False, True
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
            known = np.min(sure[~unproved], axis=0, initial=np.inf)
            bounds = np.minimum(bounds, known)
            contact = room < 0.0
            if contact or (unproved.any() and seen > max_stretches):
                proved = False
                break
            todo = todo.cut(unproved)
        # What was measured there may have been a bound that was good enough.
        at = np.clip(time, self.pieces.t[0], self.pieces.t[-1])
        instant = np.array([at])
        exact = self.checker.distances(self.pieces(instant), times=instant)[0]
        pair = int(np.argmin(exact - least))
        own = np.arange(margins.size) >= self.checker.obstacle_pairs
        nearest = Contact(
            *self.checker.pairs[pair],
            float(exact[pair]),
            own=bool(own[pair]),
            margin=float(margins[pair]),
        )
        each = zip(own.tolist(), margins.tolist(), bounds.tolist(), strict=True)
        kept = _kept(Kept(KINDS[own], *rest) for own, *rest in each) if proved else ()
        return ClearanceProof(proved, kept, nearest, time, contact, seen)

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
