"""Report on the first-order conditions: how well they hold, and which fails where."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from tominpmp.certificate.certificate import Certificate
from tominpmp.certificate.limits import ARRIVAL, GOAL, SEGMENT, TRUST
from tominpmp.certificate.motion import GridMotion
from tominpmp.motion_limits import EFFORT, POSITION
from tominpmp.verification.verification import Verification

if TYPE_CHECKING:
    from tominpmp.certificate.dual_program import DualSolution

# Largest tolerated mean deviation of the Hamiltonian; the cost of time is 1.
HAMILTONIAN = 0.2
# Least share of the time for which torques must obey their switching functions.
SIGN_SHARE = 0.95
# Additional gain of a finer grid, as a share of T, from which the report mentions it.
FINER_GAIN = 0.005
# Share below which a report says "less than 0.001 %".
LEAST_SHARE = 1e-5


def subject_name(motion: GridMotion, kind: str, subject: int) -> str:
    """Name of the joint, pair, segment or frame to which a limit applies.

    Args:
        motion: The motion.
        kind: Kind of the limit.
        subject: Number of the subject, see :class:`~.limits.LimitRows`.
    """
    if kind == ARRIVAL:
        return f"segment {subject + 1}"
    number, index = divmod(subject, SEGMENT)
    problem = motion.segments[number].system.problem
    if kind == "clearance":
        return " and ".join(problem.checker.pairs[index])
    if kind in {item.name for item in motion.constraints}:
        return str(problem.constraints[index].subject)
    return problem.robot.joint_names[subject]


def _time_dependence(motion: GridMotion) -> str:
    """Reason why the Hamiltonian need not be constant; empty if it has to be.

    Moving obstacles, arrival times, and constraints with a time window make limits
    depend on time, not only on the state.
    """
    if any(part.system.problem.scene.moving for part in motion.segments):
        return "Obstacles move"
    timed = any(item.arrival is not None for item in motion.system.problem.segments)
    if timed or any(item.during is not None for item in motion.constraints):
        return "Limits depend on time"
    return ""


def _control(motion: GridMotion) -> str:
    """Name of the control of a joint in sentences."""
    return "acceleration" if motion.system.problem.robot.kinematic else "torque"


def conditions_kept(motion: GridMotion, out: Certificate, rounding: float) -> str:
    """Sentences on a motion that satisfies all first-order conditions.

    Args:
        motion: The motion.
        out: The certificate of the motion.
        rounding: Share of T that rounding to a clock may have cost; zero without a
            clock.
    """
    T, reason = float(out.t[-1]), _time_dependence(motion)
    controls = f"{_control(motion)}s"
    constancy = (
        f"The Hamiltonian is constant within {out.hamiltonian_mean_deviation:.1g} in "
        f"the mean ({out.hamiltonian_deviation:.1g} at most), {controls}"
        if not reason
        else f"{reason}, so that the Hamiltonian need not be constant. "
        f"{controls.capitalize()}"
    )
    text = (
        "The motion satisfies the first-order conditions to "
        f"{_percent(out.stationarity)}: small changes promise no more than "
        f"{_time(out.stationarity * T)} of its {T:.4g} s. {constancy} obey their "
        f"switching functions {_percent(out.sign_share)} of the time, and at least "
        f"one limit is active {_percent(out.active_share)} of the time."
    )
    if rounding:
        text += (
            " The clock of its controller rounds its duration up by "
            f"{_percent(rounding)} at most."
        )
    if out.grid_gain > out.stationarity + FINER_GAIN:
        text += (
            f" {controls.capitalize()} that switch within the intervals of the grid "
            f"could gain up to {_percent(out.grid_gain)}."
        )
    return text


def failed_conditions(
    motion: GridMotion,
    dual: DualSolution,
    out: Certificate,
    verification: Verification,
    *,
    fastest: bool,
) -> Iterator[str]:
    """A sentence for each condition that fails, with its joint or limit and time.

    Args:
        motion: The motion.
        dual: Costates and multipliers of the motion.
        out: The certificate of the motion, without message and verdict.
        verification: Verification of the motion.
        fastest: Whether T is not rounded up to a clock: a motion that waits for the
            next tick may have any torques.
    """
    h, T = motion.changes.h, float(motion.changes.t[-1])
    if not verification.ok:
        yield f"The motion is not admissible: {verification.message}"
    if not out.stationarity <= out.tolerance:
        yield (
            "The motion does not satisfy the first-order conditions: small changes "
            f"promise {_percent(out.stationarity)} of its duration "
            f"({_time(out.stationarity * T)}). {_worst(motion, dual)}"
        )
    if not fastest:
        return
    constant = out.hamiltonian_mean_deviation <= HAMILTONIAN
    if not (constant or _time_dependence(motion)):
        deviation = np.abs(out.hamiltonian - np.average(out.hamiltonian, weights=h))
        k = int(np.argmax(deviation * h))
        yield (
            "The Hamiltonian is not constant: it deviates by "
            f"{out.hamiltonian_mean_deviation:.2g} in the mean, and by "
            f"{deviation[k]:.2g} at {_middle(motion, k):.3f} s."
        )
    if not out.sign_share >= SIGN_SHARE:
        lost = np.abs(out.switching) * ~out.obeys * h[:, None]
        joint = int(np.argmax(lost.sum(axis=0)))
        k = int(np.argmax(lost[:, joint]))
        control = _control(motion)
        yield (
            f"{control.capitalize()}s obey the signs of their switching functions only "
            f"{_percent(out.sign_share)} of the time; the worst is the {control} of "
            f"joint {out.joint_names[joint]}, about {_middle(motion, k):.3f} s."
        )


def _middle(motion: GridMotion, k: int) -> float:
    """Middle of an interval [s]."""
    return float(0.5 * (motion.changes.t[k] + motion.changes.t[k + 1]))


def _worst(motion: GridMotion, dual: DualSolution) -> str:
    """Sentence on the limit, or joint, with the largest predicted gain."""
    limits = dual.multipliers
    gain, interval = limits.predicted_gain, limits.at.interval
    # One sum for each kind and subject.
    owners = list(zip(limits.kind.tolist(), limits.subject.tolist(), strict=True))
    sums = dict.fromkeys(owners, 0.0)
    for owner, value in zip(owners, gain.tolist(), strict=True):
        sums[owner] += value
    kind, subject = max(sums, key=lambda owner: sums[owner])
    own = np.where(limits.of(kind) & (limits.subject == subject), gain, 0.0)
    k = int(np.argmax(np.bincount(interval, weights=own)))
    peak = int(np.argmax(np.where(interval == k, own, -1.0)))
    slack, upper = float(limits.slack[peak]), bool(limits.upper_active[peak])
    clause = _gain_clause(motion, kind, subject, slack, upper)
    share = f"{_percent(sums[kind, subject])} of the duration"
    if kind in (ARRIVAL, GOAL):
        return f"Most of it, {share}{clause}."
    return f"Most of it, {share}{clause} at {_middle(motion, k):.3f} s."


def _gain_clause(
    motion: GridMotion, kind: str, subject: int, slack: float, upper: bool
) -> str:
    """Clause on where the predicted gain is: a limit with slack, the path or the pace.

    Args:
        motion: The motion.
        kind: Kind of the limit.
        subject: Number of the subject, see :class:`~.limits.LimitRows`.
        slack: Slack to the limit whose multiplier is positive.
        upper: Whether it is the upper limit.
    """
    if kind == GOAL:
        return ", is in the final state of the motion"
    if kind == ARRIVAL:
        side = "earlier" if upper else "later"
        met = f"the goal of segment {subject + 1} is met {_time(slack)} {side}"
        return f": {met} than necessary"
    if kind == TRUST and subject < 0:
        return ", is in the pace"
    name = subject_name(motion, kind, subject)
    if kind == TRUST:
        return f", is in the path: no limit holds joint {name} where it is"
    if kind == "clearance":
        return f": {name} are {1e3 * slack:.3g} mm farther apart than necessary"
    if kind in {item.name for item in motion.constraints}:
        number, index = divmod(subject, SEGMENT)
        item = motion.segments[number].system.problem.constraints[index]
        quantity, side, by = f"the {kind}", "", f"{slack:.3g} {item.unit}"
    else:
        quantity = f"the {'torque' if kind == EFFORT.name else kind} of joint {name}"
        side = "upper " if upper else "lower "
        by = f"{slack:.3g}" if kind == POSITION.name else f"{_percent(slack)} of it"
    limit = f"{side}limit that its multiplier requires"
    return f": {quantity} stays off the {limit}, by {by} and most"


def _percent(share: float) -> str:
    """A share in per cent, with two digits where it is small."""
    if share < LEAST_SHARE:
        return "less than 0.001 %"
    percent = 100.0 * share
    if percent >= 99.95:
        return "100 %"
    return f"{percent:.3g} %" if percent >= 10.0 else f"{percent:.2g} %"


def _time(seconds: float) -> str:
    """A time in words, with its unit."""
    if seconds < 1e-6:
        return "a microsecond"
    if seconds < 0.1:
        return f"{1e3 * seconds:.2g} ms"
    return f"{seconds:.3g} s"
