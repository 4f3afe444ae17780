"""Report on the first-order conditions: how well they are kept, which fails where."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.certificate.certificate import Certificate
from tominpmp.certificate.limits import ARRIVAL, GOAL, SEGMENT, TRUST
from tominpmp.certificate.motion import Motion
from tominpmp.motion_limits import EFFORT, POSITION
from tominpmp.verification.verification import Verification

if TYPE_CHECKING:
    from tominpmp.certificate.dual_program import DualSolution

# Largest mean deviation of the Hamiltonian; the cost of time is 1.
HAMILTONIAN = 0.2
# Least share of the time for which torques must obey their switching functions.
SIGN_SHARE = 0.95
# A coarse grid is mentioned where a finer one predicts this share of T more.
FINER_GAIN = 0.005
# Shares below this are reported as rounding.
LEAST_SHARE = 1e-5


def name_of(motion: Motion, kind: str, subject: int) -> str:
    """Name of the joint, or of the pair, that a limit belongs to."""
    if kind == "clearance":
        number, pair = divmod(subject, SEGMENT)
        one, other = motion.segments[number].system.problem.checker.pairs[pair]
        return f"{one} and {other}"
    if kind == ARRIVAL:
        return f"segment {subject + 1}"
    for item in motion.constraints:
        if item.name == kind:
            return str(item.subject)
    return motion.system.problem.robot.joint_names[subject]


def _what_depends_on_time(motion: Motion) -> str:
    """Why the Hamiltonian may change; empty where limits depend on the state alone.

    Moving obstacles, arrival times, and constraints that hold for a while depend on
    time.
    """
    if any(one.system.problem.scene.moving for one in motion.segments):
        return "Obstacles move"
    timed = any(one.arrival is not None for one in motion.system.problem.segments)
    if timed or any(item.during is not None for item in motion.constraints):
        return "Limits depend on time"
    return ""


def conditions_kept(motion: Motion, out: Certificate, rounding: float = 0.0) -> str:
    """Sentences on a motion that keeps all first-order conditions.

    Args:
        motion: The motion.
        out: Its certificate.
        rounding: Share of T that rounding to its clock may have cost.
    """
    T, reason = float(out.t[-1]), _what_depends_on_time(motion)
    constancy = (
        f"The Hamiltonian is constant within {out.hamiltonian_mean_deviation:.1g} in "
        f"the mean ({out.hamiltonian_deviation:.1g} at most), torques"
        if not reason
        else f"{reason}, so that the Hamiltonian need not be constant. Torques"
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
) -> Iterator[str]:
    """A sentence for each condition that fails, with where.

    Args:
        motion: The motion.
        found: Its multipliers.
        out: Its certificate so far.
        verification: Its replay, if there is one.
        fastest: Whether T is not rounded up to a clock: a motion that waits for the
            next tick may have any torques.
    """
    h, T = motion.changes.h, float(motion.changes.t[-1])
    if verification is not None and not verification.ok:
        yield f"The motion is not admissible: {verification.message}"
    if not out.stationarity <= out.tolerance:
        yield (
            "The motion does not satisfy the first-order conditions: small changes "
            f"promise {_percent(out.stationarity)} of its duration "
            f"({_time(out.stationarity * T)}). {_worst(motion, found)}"
        )
    if not fastest:
        return
    constant = out.hamiltonian_mean_deviation <= HAMILTONIAN
    if not (constant or _what_depends_on_time(motion)):
        apart = np.abs(out.hamiltonian - np.average(out.hamiltonian, weights=h))
        k = int(np.argmax(apart * h))
        yield (
            "The Hamiltonian is not constant: it is off by "
            f"{out.hamiltonian_mean_deviation:.2g} in the mean, and by "
            f"{apart[k]:.2g} at {_middle(motion, k):.3f} s."
        )
    if not out.sign_share >= SIGN_SHARE:
        lost = np.abs(out.switching) * ~out.obeys * h[:, None]
        joint = int(np.argmax(lost.sum(axis=0)))
        k = int(np.argmax(lost[:, joint]))
        yield (
            "Torques obey the signs of their switching functions only "
            f"{_percent(out.sign_share)} of the time; the worst is that of joint "
            f"{out.joint_names[joint]}, about {_middle(motion, k):.3f} s."
        )


def _middle(motion: Motion, k: int) -> float:
    return float(0.5 * (motion.changes.t[k] + motion.changes.t[k + 1]))


def _worst(motion: Motion, found: DualSolution) -> str:
    """The limit, or the joint, with the largest predicted gain, and when."""
    given = found.multipliers
    promise, interval = given.promise, given.at.interval
    # One sum for each kind and subject.
    owners = list(zip(given.kind.tolist(), given.subject.tolist(), strict=True))
    sums = dict.fromkeys(owners, 0.0)
    for owner, value in zip(owners, promise.tolist(), strict=True):
        sums[owner] += value
    kind, subject = max(sums, key=lambda owner: sums[owner])
    own = np.where(given.of(kind) & (given.subject == subject), promise, 0.0)
    k = int(np.argmax(np.bincount(interval, weights=own)))
    peak = int(np.argmax(np.where(interval == k, own, -1.0)))
    room, upper = float(given.room[peak]), bool(given.held_above[peak])
    what = _what_gives(motion, kind, subject, room, upper)
    share = f"{_percent(sums[kind, subject])} of the duration"
    if kind in (ARRIVAL, GOAL):
        return f"Most of it, {share}{what}."
    return f"Most of it, {share}{what} at {_middle(motion, k):.3f} s."


def _what_gives(
    motion: Motion, kind: str, subject: int, room: float, upper: bool
) -> str:
    """How a limit, or a joint without an active limit, loses a part of the duration."""
    if kind == GOAL:
        return ", is in where the motion ends"
    if kind == ARRIVAL:
        side = "earlier" if upper else "later"
        met = f"the goal of segment {subject + 1} is met {_time(room)} {side}"
        return f": {met} than need be"
    if kind == TRUST and subject < 0:
        return ", is in the pace"
    name = name_of(motion, kind, subject)
    if kind == TRUST:
        return f", is in the path: no limit holds joint {name} where it is"
    if kind == "clearance":
        return f": {name} are {1e3 * room:.3g} mm farther apart than need be"
    if kind in {item.name for item in motion.constraints}:
        number, index = divmod(subject, SEGMENT)
        item = motion.segments[number].system.problem.constraints[index]
        what, side, far = f"the {kind}", "", f"{room:.3g} {item.unit}"
    else:
        what = f"the {'torque' if kind == EFFORT.name else kind} of joint {name}"
        side = "upper " if upper else "lower "
        far = f"{room:.3g}" if kind == POSITION.name else f"{_percent(room)} of it"
    limit = f"{side}limit that its multiplier asks for"
    return f": {what} stays off the {limit}, by {far} and most"


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
