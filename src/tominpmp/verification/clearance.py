r"""Proof that a motion keeps clear, between the samples too (conservative advancement).

A stretch of time is clear if the distance of every pair in its middle is larger than
the displacements of their points within the stretch. Else the stretch is cut, for that
pair alone, by the search of :mod:`~.closest_approach`. A point that the joints i move
is displaced by at most :math:`\sum_i r_i |\Delta q_i|` while the joints move by
:math:`|\Delta q_i|` at most, where r_i bounds its distance from the axis of joint i (1
for sliding joints). A point of a moving obstacle comes closer by its largest speed
times the duration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tominpmp.arrays import Array, array_or_nan
from tominpmp.blas_threads import on_one_thread
from tominpmp.checks import instance, whole, wrong
from tominpmp.collision.checker import CollisionChecker, Contact
from tominpmp.exceptions import ProblemError
from tominpmp.motion.curves import states
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.verification.closest_approach import Approach
from tominpmp.verification.replay import Replay, planned
from tominpmp.verification.stages import stages_of

# Largest number of stretches for each pair before the proof is given up.
MAX_STRETCHES = 20_000
# Beyond this number of kinds of pairs only the least and the largest margin are named.
MOST_KINDS = 3
# Names of the kinds of pairs.
KINDS = ("links and obstacles", "links of the robot")
# Deviations of polynomials are bounded by this multiple of the measured deviations.
OFF = 2.0


class Kept(NamedTuple):
    """A distance that pairs of one kind and margin keep at all times.

    Attributes:
        pairs: The kind of pairs, in words.
        margin: Their margin [m].
        bound: Their proved distance [m]: at least the margin less the tolerated slack.
    """

    pairs: str
    margin: float
    bound: float

    def words(self, pairs: str) -> str:
        """The proved distance, in words.

        Args:
            pairs: Name of the pairs.
        """
        # At most the margin and the proved distance: the last digit is rounded down.
        least = math.floor(1e4 * min(self.margin, self.bound) * (1.0 + 1e-12)) / 1e4
        apart = f"at least {least:.4f} m apart"
        if least <= 0.0:
            lack = math.ceil(-1e5 * self.bound) / 1e5
            apart = "apart" if self.bound > 0.0 else f"clear but for {lack:.5f} m"
        return f"{pairs} {apart} ({_asked(self.margin)})"


@dataclass(frozen=True)
class ClearanceProof:
    """Proof of the clearance of a motion at all times, or its failure.

    Attributes:
        proved: Whether every pair keeps its margin at every time.
        kept: Proved distances, pairs of one margin together; empty without a proof.
        nearest: The pair with the least measured clearance beyond its margin, and its
            distance; None without pairs.
        time: Time of that distance [s].
        contact: Whether a distance below the required one was measured.
        stretches: Number of examined stretches of time, for each pair alone.
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
        """Distance that all pairs are proved to keep, whatever their margins [m].

        Minus infinity after a contact or a proof that was given up, infinite without
        pairs.
        """
        if not self.proved:
            return -math.inf
        return min((item.bound for item in self.kept), default=math.inf)

    @property
    def distance(self) -> float:
        """Distance of the nearest pair [m]."""
        return math.inf if self.nearest is None else self.nearest.distance

    @property
    def pair(self) -> tuple[str, str] | None:
        """Names of the nearest pair; None without pairs."""
        return None if self.nearest is None else self.nearest[:2]

    @property
    def room(self) -> float:
        """Distance of the nearest pair beyond its margin [m]."""
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
        """The proved distances with their pairs, in words."""
        margins = [item.margin for item in self.kept]
        if len(margins) > MOST_KINDS:
            return (
                "every pair keeps the margin asked of it at all times, "
                f"{min(margins):.4g} to {max(margins):.4g} m"
            )
        clauses = [item.words(f"{item.pairs} stay") for item in self.kept]
        if len(set(margins)) == 1:
            tightest = min(self.kept, key=lambda item: item.bound)
            clauses = [tightest.words("every pair stays")]
        return f"{', '.join(clauses)} at all times"


# The proof for a robot without pairs.
NOTHING_NEAR = ClearanceProof(True, (), None, 0.0, False, 0)


def _kept(found: Iterable[Kept]) -> tuple[Kept, ...]:
    """Proved distances, pairs of one kind and margin together."""
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
        slack: Tolerated violation of the margin [m]. Along a motion at the margin the
            proof needs stretches in which links move no farther than this.
        deviation: Largest deviations of the real motion from the trajectory by joint,
            shape (n,) [rad or m]: those of a replay, say.
        max_stretches: Number of stretches after which the proof is given up, in the
            mean over the pairs.

    Returns:
        The proof, or its failure. For an obstacle that a function without bounds on its
        speed moves, the proof rests on estimates of its speed.
    """
    expected = "a CollisionChecker: problem.checker"
    instance(checker, CollisionChecker, "checker", expected)
    instance(trajectory, Trajectory, "trajectory")
    pairs, n = len(checker.pairs), checker.robot.n
    if trajectory.n != n:
        raise ProblemError(
            f"trajectory moves {trajectory.n} joints, the robot has {n}", "trajectory"
        )
    margins = np.broadcast_to(_lengths(margin, "margin", pairs), pairs)
    slack = float(_lengths(slack, "slack", None))
    if deviation is not None:
        deviation = _lengths(deviation, "deviation", n)
    max_stretches = whole(max_stretches, "max_stretches")
    if not checker.pairs:
        return NOTHING_NEAR
    motion, stray = _rows(trajectory, deviation)
    return _proof(checker, motion, margins, stray, slack, max_stretches)


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
    motion, stray = _rows(trajectory, deviation)
    for stage in stages_of(problem, trajectory):
        checker = stage.problem.checker
        if checker.pairs and stage.end > stage.begin:
            part = motion.between(stage.begin, stage.end)
            proofs.append(_proof(checker, part, stage.problem.margins, stray))
    if not proofs:
        return NOTHING_NEAR
    worst = min(proofs, key=lambda item: (item.proved, item.room))
    return replace(
        worst,
        kept=_kept(kept for item in proofs for kept in item.kept) if worst else (),
        stretches=sum(item.stretches for item in proofs),
    )


def _lengths(value: object, name: str, count: int | None) -> Array:
    """Check finite lengths: a single one, or one for each of a number of items."""
    array = array_or_nan(value)
    if not np.all(np.isfinite(array)) or array.shape not in ((), (count,)):
        each = "" if count is None else f", or {count} of them"
        raise wrong(value, name, f"a finite number{each}")
    return array


def _proof(
    checker: CollisionChecker,
    motion: Replay,
    margins: Array,
    stray: Array,
    slack: float = 0.0,
    max_stretches: int = MAX_STRETCHES,
) -> ClearanceProof:
    """The proof of a motion, or its failure.

    Args:
        checker: Distances of the pairs.
        motion: The motion.
        margins: Distances to keep by pair, shape (pairs,) [m].
        stray: Largest deviations of joints from the motion, shape (n,) [rad or m].
        slack: Tolerated violation of the margins [m].
        max_stretches: Number of stretches after which the proof is given up.
    """
    least, most = margins - slack, max_stretches * margins.size
    found = Approach(checker, motion, least, stray=stray, most=most).run()
    nearest = found.nearest()._replace(margin=float(margins[found.pair]))
    own = np.arange(margins.size) >= checker.obstacle_pairs
    proved = not found.violated and found.doubt == 0.0
    bounds = least + max(found.sure, 0.0)
    each = zip(own.tolist(), margins.tolist(), bounds.tolist(), strict=True)
    kept = _kept(Kept(KINDS[own], *rest) for own, *rest in each) if proved else ()
    return ClearanceProof(
        proved, kept, nearest, found.time, found.violated, found.stretches
    )


def _rows(trajectory: Trajectory, deviation: Array | None) -> tuple[Replay, Array]:
    """A motion in rows, and the deviations of joints from the polynomials between them.

    Args:
        trajectory: The motion.
        deviation: Largest deviations of joints from it, shape (n,) [rad or m]; None for
            zero.

    Returns:
        The rows, and the largest deviations, shape (n,) [rad or m].
    """
    stray = np.zeros(trajectory.n) if deviation is None else np.abs(deviation)
    path = replace(trajectory, inverse_dynamics=None)  # its torques take time
    rows = planned(path)
    if rows.t.size < 2:
        return rows, stray
    probes = (rows.t[:-1] + np.diff(rows.t) * np.array([[0.3], [0.5]])).ravel()
    joined, *_ = states(rows.t, rows.q, rows.v, None, probes)
    gaps = np.abs(joined - path(probes).q)
    return rows, stray + OFF * np.max(gaps, axis=0)
