"""Report on the first-order conditions: how well they are kept, which fails where."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tominpmp.arrays import Array
from tominpmp.certificate.certificate import Certificate
from tominpmp.certificate.dual_program import DualSolution
from tominpmp.certificate.limit_rows import GOAL, TRUST
from tominpmp.certificate.limits import ARRIVAL
from tominpmp.certificate.motion import Motion
from tominpmp.options import Tolerances
from tominpmp.verification.verification import Verification

# By how much the Hamiltonian may be off in the mean; the cost of time is 1.
HAMILTONIAN = 0.2
# Torques must obey their switching functions for this share of the time.
SIGN_SHARE = 0.95
# A coarse grid is mentioned where a finer one promises this share of T more.
FINER_GAIN = 0.005
# Shares below this are rounding.
LEAST_SHARE = 1e-5


def name_of(motion: Motion, kind: str, subject: int) -> str:
    """Name of the joint, or of the pair, that a limit belongs to."""
    if kind == "clearance":
        one, other = motion.pairs[subject]
        return f"{one} and {other}"
    if kind == ARRIVAL:
        return f"segment {subject + 1}"
    for item in motion.constraints:
        if item.name == kind:
            return str(item.subject)
    return motion.task.problem.robot.joint_names[subject]


def autonomous(motion: Motion) -> bool:
    """Whether nothing but the state decides what is allowed, so that H is constant.

    Obstacles that move, times at which goals are to be met, and constraints that hold
    for a time depend on more.
    """
    return not (_obstacles_move(motion) or _on_time(motion))


def _obstacles_move(motion: Motion) -> bool:
    return any(one.task.problem.scene.moving for one in motion.segments)


def _on_time(motion: Motion) -> bool:
    """Whether something is asked for at some times only."""
    timed = any(one.arrival is not None for one in motion.task.problem.segments)
    held = (item for one in motion.segments for item in one.task.problem.constraints)
    return timed or any(item.during is not None for item in held)


def _what_depends_on_time(motion: Motion) -> str:
    """Why the Hamiltonian may change."""
    if _obstacles_move(motion):
        return "Obstacles move"
    return "Limits depend on time"


def conditions_kept(motion: Motion, out: Certificate, rounding: float = 0.0) -> str:
    """Sentences on a motion that keeps all first-order conditions.

    Args:
        motion: The motion.
        out: Its certificate.
        rounding: Share of T that its clock may have cost.
    """
    T = float(out.t[-1])
    constancy = (
        f"The Hamiltonian is constant within {out.hamiltonian_mean_deviation:.1g} in "
        f"the mean ({out.hamiltonian_deviation:.1g} at most), torques"
        if autonomous(motion)
        else f"{_what_depends_on_time(motion)}, so that the Hamiltonian need not be "
        "constant. Torques"
    )
    text = (
        "The motion satisfies the first-order conditions to "
        f"{_percent(out.stationarity)}: small changes promise no more than "
        f"{_time(out.stationarity * T)} of its {T:.4g} s. {constancy} obey their "
        f"switching functions {_percent(out.sign_share)} of the time, and some limit "
        f"holds the motion {_percent(out.active_share)} of the time."
    )
    if rounding:
        text += (
            " The clock of its controller rounds its duration up by "
            f"{_percent(rounding)} at most."
        )
    if out.grid_gain > out.stationarity + FINER_GAIN:
        text += (
            " Torques that switch within the intervals of the grid could gain up to "
            f"{_percent(out.grid_gain)}."
        )
    return text


def failed_conditions(
    motion: Motion,
    found: DualSolution,
    out: Certificate,
    verification: Verification | None,
    *,
    fastest: bool = True,
) -> list[str]:
    """A sentence for each condition that fails, with where.

    Args:
        motion: The motion.
        found: Its multipliers.
        out: Its certificate so far.
        verification: Its replay, if there is one.
        fastest: Whether it takes no longer than it must: one that waits for the next
            tick may do so with any torques.
    """
    return list(_Failures(motion, found, out).sentences(verification, fastest))


class _Failures:
    """What is wrong with a motion."""

    def __init__(self, motion: Motion, found: DualSolution, out: Certificate) -> None:
        self.motion, self.found, self.out = motion, found, out
        self.names = out.joint_names
        self.t = motion.changes.t
        self.h, self.T = motion.changes.h, float(motion.changes.t[-1])

    def sentences(
        self, verification: Verification | None, fastest: bool
    ) -> Iterator[str]:
        """One for each condition that fails."""
        out = self.out
        if verification is None:
            flaw = self._flaw()
        else:
            flaw = "" if verification.ok else verification.message
        if flaw:
            yield f"The motion is not admissible: {flaw}"
        if not out.stationarity <= out.tolerance:
            yield (
                "The motion does not satisfy the first-order conditions: small changes "
                f"promise {_percent(out.stationarity)} of its duration "
                f"({_time(out.stationarity * self.T)}). {self._worst()}"
            )
        if not fastest:
            return
        constant = out.hamiltonian_mean_deviation <= HAMILTONIAN
        if autonomous(self.motion) and not constant:
            apart = np.abs(
                out.hamiltonian - np.average(out.hamiltonian, weights=self.h)
            )
            k = int(np.argmax(apart * self.h))
            yield (
                "The Hamiltonian is not constant: it is off by "
                f"{out.hamiltonian_mean_deviation:.2g} in the mean, and by "
                f"{apart[k]:.2g} at {self._middle(k):.3f} s."
            )
        if not out.sign_share >= SIGN_SHARE:
            lost = np.abs(out.switching) * ~out.obeys * self.h[:, None]
            joint = int(np.argmax(lost.sum(axis=0)))
            k = int(np.argmax(lost[:, joint]))
            yield (
                "Torques obey the signs of their switching functions only "
                f"{_percent(out.sign_share)} of the time; the worst is that of joint "
                f"{self.names[joint]}, about {self._middle(k):.3f} s."
            )

    def _flaw(self) -> str:
        """What keeps a motion that was not replayed from being one of the problem."""
        system, changes = self.motion.task, self.motion.changes
        problem, tolerances = system.problem, Tolerances()
        apart = np.abs([changes.q[0] - problem.q_start, changes.v[0] - system.v_start])
        if float(apart.max()) > tolerances.goal:
            joint = self.names[int(np.argmax(apart.max(axis=0)))]
            return f"joint {joint} does not start where the problem does."
        misses = problem.goal.misses(system.kinematics, changes.q[-1], changes.v[-1])
        for miss in sorted(misses, key=lambda miss: -miss.amount):
            if miss.amount > (tolerances.speed if miss.moving else tolerances.goal):
                return f"{miss.name} ends {miss.amount:.3g} {miss.unit} from the goal."
        load = np.abs(self.motion.loads).max(axis=1)
        if changes.shape == "torques":
            load = np.abs(self.motion.load)
        undriven = np.setdiff1d(np.arange(changes.n), self.motion.driven)
        load[:, undriven] = 0.0
        return self._over(load, tolerances.limits)

    def _over(self, load: Array, tolerance: float) -> str:
        changes, limits = self.motion.changes, self.motion.task.problem.robot.limits
        speed = np.abs(changes.v) / limits.velocity
        for what, share in (("torque", load), ("velocity", speed[1:])):
            k, joint = np.unravel_index(int(np.argmax(share)), share.shape)
            if share[k, joint] > 1.0 + tolerance:
                return (
                    f"the {what} of joint {self.names[joint]} is "
                    f"{_percent(share[k, joint] - 1.0)} beyond its limit at "
                    f"{self.t[k + 1]:.3f} s."
                )
        return ""

    def _middle(self, k: int) -> float:
        return float(0.5 * (self.t[k] + self.t[k + 1]))

    def _worst(self) -> str:
        """The limit, or the joint, that gives away most, and when."""
        given = self.found.multipliers
        promise = given.promise
        # One number for each kind and subject.
        owners = list(zip(given.kind.tolist(), given.subject.tolist(), strict=True))
        names = {owner: number for number, owner in enumerate(dict.fromkeys(owners))}
        of_group = np.array([names[owner] for owner in owners])
        sums = np.bincount(of_group, weights=promise)
        rows = np.flatnonzero(of_group == int(np.argmax(sums)))
        total, interval = float(sums.max()), given.at.interval
        at = np.bincount(interval[rows], weights=promise[rows])
        k = int(np.argmax(at))
        peak = rows[np.argmax(promise[rows] * (interval[rows] == k))]
        kind, subject = owners[peak]
        when, room = self._middle(k), float(given.room[peak])
        share = f"{_percent(total)} of the duration"
        if kind == TRUST:
            if subject < 0:
                return f"Most of it, {share}, is in the pace at {when:.3f} s."
            return (
                f"Most of it, {share}, is in the path: no limit holds joint "
                f"{self.names[subject]} where it is at {when:.3f} s."
            )
        if kind == "clearance":
            name = name_of(self.motion, kind, subject)
            return (
                f"Most of it, {share}: {name} are {1e3 * room:.3g} mm farther apart "
                f"than need be at {when:.3f} s."
            )
        if kind == ARRIVAL:
            side = "earlier" if given.held_above[peak] else "later"
            return (
                f"Most of it, {share}: the goal of segment {subject + 1} is met "
                f"{_time(room)} {side} than need be."
            )
        if kind == GOAL:
            return f"Most of it, {share}, is in where the motion ends."
        constraints = self.motion.constraints
        if kind in {item.name for item in constraints}:
            return (
                f"Most of it, {share}: the {kind} stays off the limit that its "
                f"multiplier asks for, by {room:.3g} {constraints[subject].unit} and "
                f"most at {when:.3f} s."
            )
        what = {"effort": "torque"}.get(kind, kind)
        side = "upper" if given.held_above[peak] else "lower"
        far = f"{room:.3g}" if kind == "position" else f"{_percent(room)} of it"
        return (
            f"Most of it, {share}: the {what} of joint {self.names[subject]} stays off "
            f"the {side} limit that its multiplier asks for, by {far} and most at "
            f"{when:.3f} s."
        )


def _percent(share: float) -> str:
    """A share in per cent, with two digits where it is small."""
    if share < LEAST_SHARE:
        return "less than 0.001 %"
    percent = 100.0 * share
    if percent >= 99.95:
        return "100 %"
    return f"{percent:.3g} %" if percent >= 10.0 else f"{percent:.2g} %"


def _time(seconds: float) -> str:
    """A time in words."""
    if seconds < 1e-6:
        return "a microsecond"
    if seconds < 0.1:
        return f"{1e3 * seconds:.2g} ms"
    return f"{seconds:.3g} s"
