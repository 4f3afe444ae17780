r"""Proof of the clearance of a motion at all times, by conservative advancement.

A time interval is clear if the distance of every pair in the middle of the interval is
larger than the displacements of the points of the pair within the interval. Otherwise
the interval is subdivided, for this pair alone, by the search of
:mod:`~.closest_approach`. While the joints i move by at most :math:`|\Delta q_i|`, a
point that they move is displaced by at most :math:`\sum_i r_i |\Delta q_i|`, where r_i
bounds the distance of the point from the axis of joint i (1 for prismatic joints). A
point of a moving obstacle comes closer by at most its largest speed times the duration.
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
from tominpmp.motion.curves import curve_through
from tominpmp.motion.trajectory import Trajectory
from tominpmp.problem.problem import Problem
from tominpmp.verification.closest_approach import ClosestApproach
from tominpmp.verification.replay import Replay, planned
from tominpmp.verification.stages import stages_of

# Largest number of time intervals, in the mean over the pairs, before the proof is
# given up.
MAX_STRETCHES = 20_000
# Number of kinds of pairs beyond which a message names only the range of their margins.
MOST_KINDS = 3
# Names of the kinds of pairs.
KINDS = ("links and obstacles", "links of the robot")
# Safety factor on the measured deviations from the polynomials between samples.
SAFETY = 2.0


class ProvedDistance(NamedTuple):
    """Distance that all pairs of one kind and margin keep at all times.

    Attributes:
        pairs: Name of the kind of pairs.
        margin: Margin of the pairs [m].
        bound: Proved distance [m]: at least the margin minus the tolerated slack.
    """

    pairs: str
    margin: float
    bound: float

    def words(self, pairs: str) -> str:
        """The proved distance, in words.

        Args:
            pairs: The pairs with a verb, such as "every pair stays".
        """
        # A rounded distance must not exceed the proof: the last digit is rounded down.
        least = math.floor(1e4 * min(self.margin, self.bound) * (1.0 + 1e-12)) / 1e4
        apart = f"at least {least:.4f} m apart"
        if least <= 0.0:
            lack = math.ceil(-1e5 * self.bound) / 1e5
            apart = "apart" if self.bound > 0.0 else f"clear but for {lack:.5f} m"
        return f"{pairs} {apart} ({_required(self.margin)})"


@dataclass(frozen=True)
class ClearanceProof:
    """Proof of the clearance of a motion at all times, or its failure.

    Attributes:
        proved: Whether every pair keeps its margin, minus the tolerated slack, at every
            time.
        kept: Proved distances, for the pairs of each kind and margin; empty without a
            proof.
        nearest: The pair with the least measured clearance beyond its margin, and its
            distance; None without pairs.
        time: Time of the least measured clearance [s].
        contact: Whether a distance below a margin minus the slack was measured.
        stretches: Number of examined time intervals, counted for each pair.
    """

    proved: bool
    kept: tuple[ProvedDistance, ...]
    nearest: Contact | None
    time: float
    contact: bool
    stretches: int

    def __bool__(self) -> bool:
        """Whether the clearance is proved."""
        return self.proved

    @property
    def bound(self) -> float:
        """Least proved distance of all pairs, whatever their margins [m].

        Minus infinity if a contact was found or the proof was given up; infinite
        without pairs.
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
        near, margin = self.nearest, _required(self.nearest.margin)
        apart = f"{near.distance:{'.4f' if self.proved else '.4g'}} m"
        place = f"{near.pair}, {apart} at {self.time:.3f} s"
        if self.contact:
            return f"Not clear: too close are {place} ({margin})."
        if self.proved:
            seen = "the closest approach measured is"
            if len({item.margin for item in self.kept}) > 1:
                seen = "the least measured clearance is between"
            return f"Proved: {self._statement}; {seen} {place}."
        return (
            f"Neither proved nor disproved in {self.stretches} time intervals; the "
            f"least measured clearance is between {place} ({margin})."
        )

    @property
    def _statement(self) -> str:
        """The proved distances with their pairs, in words."""
        margins = [item.margin for item in self.kept]
        if len(margins) > MOST_KINDS:
            return (
                "every pair keeps its margin at all times, "
                f"{min(margins):.4g} to {max(margins):.4g} m"
            )
        clauses = [item.words(f"{item.pairs} stay") for item in self.kept]
        if len(set(margins)) == 1:
            tightest = min(self.kept, key=lambda item: item.bound)
            clauses = [tightest.words("every pair stays")]
        return f"{', '.join(clauses)} at all times"


def _merged(distances: Iterable[ProvedDistance]) -> tuple[ProvedDistance, ...]:
    """Merge proved distances of equal kind and margin into the least of them."""
    # In falling order the least bound of each kind and margin comes last.
    least = {item[:2]: item for item in sorted(distances, reverse=True)}
    return tuple(sorted(least.values()))


def _required(margin: float) -> str:
    """The required margin, in words."""
    return f"required margin {margin:.4g} m" if margin != 0.0 else "no margin required"


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
    """Prove that all pairs keep a distance along a motion, or find a violation.

    Args:
        checker: Collision checker with the pairs.
        trajectory: The motion.
        margin: Distance to keep [m], one number for all pairs or one for each pair.
        slack: Tolerated violation of the margin [m]. Where a motion is at the margin,
            the proof needs time intervals in which links move no farther than this.
        deviation: Largest deviations of the real motion from the trajectory by joint,
            shape (n,) [rad or m], for example the deviations of a replay.
        max_stretches: Number of time intervals after which the proof is given up, in
            the mean over the pairs.

    Returns:
        The proof, or its failure. For an obstacle that is moved by a function without
        bounds on its speed, the proof relies on estimates of the speed.

    Raises:
        ProblemError: If the motion has other joints than the robot, or an argument is
            invalid.
    """
    expected = "a CollisionChecker: problem.checker"
    instance(checker, CollisionChecker, "checker", expected)
    instance(trajectory, Trajectory, "trajectory")
    pairs = len(checker.pairs)
    trajectory._check_joints(checker.robot.joint_names)
    margins = np.broadcast_to(_lengths(margin, "margin", pairs), pairs)
    slack = float(_lengths(slack, "slack", None))
    if deviation is not None:
        deviation = _lengths(deviation, "deviation", trajectory.n)
    max_stretches = whole(max_stretches, "max_stretches")
    motion, drift = _rows(trajectory, deviation)
    return _proof(checker, motion, margins, drift, slack, max_stretches)


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
    motion, drift = _rows(trajectory, deviation)
    for stage in stages_of(problem, trajectory):
        section, phase = motion.between(stage.begin, stage.end), stage.problem
        proofs.append(_proof(phase.checker, section, phase.margins, drift))
    worst = min(proofs, key=lambda item: (item.proved, item.room))
    return replace(
        worst,
        kept=_merged(kept for item in proofs for kept in item.kept) if worst else (),
        stretches=sum(item.stretches for item in proofs),
    )


def _lengths(value: object, name: str, count: int | None) -> Array:
    """Check finite lengths: a single length, or one for each of a number of items."""
    array = array_or_nan(value)
    if not np.all(np.isfinite(array)) or array.shape not in ((), (count,)):
        each = "" if count is None else f", or {count} numbers"
        raise wrong(value, name, f"a finite number{each}")
    return array


def _proof(
    checker: CollisionChecker,
    motion: Replay,
    margins: Array,
    drift: Array,
    slack: float = 0.0,
    max_stretches: int = MAX_STRETCHES,
) -> ClearanceProof:
    """Proof of the clearance along the rows of a motion, or its failure.

    Args:
        checker: Collision checker with the pairs.
        motion: The motion.
        margins: Distances to keep by pair, shape (pairs,) [m].
        drift: Largest deviations of the real motion from the rows by joint, shape (n,)
            [rad or m].
        slack: Tolerated violation of the margins [m].
        max_stretches: Number of time intervals after which the proof is given up, in
            the mean over the pairs.
    """
    if not checker.pairs:
        return ClearanceProof(True, (), None, 0.0, False, 0)
    least, most = margins - slack, max_stretches * margins.size
    search = ClosestApproach(checker, motion, least, drift=drift, most=most).run()
    nearest = search.nearest()._replace(margin=float(margins[search.pair]))
    own = np.arange(margins.size) >= checker.obstacle_pairs
    proved = not search.violated and search.possible_violation == 0.0
    bounds = least + max(search.lower_bound, 0.0)
    each = zip(own.tolist(), margins.tolist(), bounds.tolist(), strict=True)
    kept = (ProvedDistance(KINDS[own], *rest) for own, *rest in each) if proved else ()
    examined = search.time, search.violated, search.intervals
    return ClearanceProof(proved, _merged(kept), nearest, *examined)


def _rows(trajectory: Trajectory, deviation: Array | None) -> tuple[Replay, Array]:
    """Rows of a motion, and the deviations from the cubic polynomials between them.

    Args:
        trajectory: The motion.
        deviation: Largest deviations of the real motion from the trajectory by joint,
            shape (n,) [rad or m]; None for zero.

    Returns:
        The rows, and the largest deviations of the real motion from the polynomials,
        shape (n,) [rad or m].
    """
    drift = np.zeros(trajectory.n) if deviation is None else np.abs(deviation)
    path = replace(trajectory, inverse_dynamics=None)  # torques are not needed
    rows = planned(path)
    probes = (rows.t[:-1] + np.diff(rows.t) * np.array([[0.3], [0.5]])).ravel()
    cubic = curve_through(rows.t, rows.q, rows.v)(probes)
    gaps = np.abs(cubic - path(probes).q)
    return rows, drift + SAFETY * np.max(gaps, axis=0, initial=0.0)
