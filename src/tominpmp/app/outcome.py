"""What was found: numbers that the page shows, few enough to pass on at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tominpmp.app.request import Request
from tominpmp.arrays import Array, Record
from tominpmp.bounds import LowerBound
from tominpmp.exceptions import ProblemError
from tominpmp.kinematics import RobotKinematics
from tominpmp.solution import Solution
from tominpmp.viz.shares import AT_LIMIT, used

# Instants at which a motion is shown.
INSTANTS = 241
# So many of the limits that hold a motion are told.
MOST_HELD = 8


@dataclass(frozen=True)
class Held:
    """A limit that holds a motion back.

    Attributes:
        what: The limit, in words: "torque of panda_joint2".
        share: Share of the time in which it holds.
        gain: Percent of T that one percent more of the limit would save, to first
            order; None where that is not known, or the limit is no size (clearance).
    """

    what: str
    share: float
    gain: float | None = None


@dataclass(frozen=True, eq=False)
class Shown(Record):
    """A motion as it is shown.

    Attributes:
        T: Its duration [s].
        verified: Whether an independent replay of the torques meets goal and limits.
        bound: Time that no motion can beat; None if it is not known.
        seconds: How long planning took [s].
        joint_names: Names of the n joints.
        t: Instants, evenly spaced [s], shape (m,).
        q: Configurations, shape (m, n) [rad or m].
        speed: Speeds as shares of their limits, shape (m, n); 0 where there is none.
        torque: Torques likewise, 0 in the middle of their range.
        path: Positions of the frame [m], shape (m, 3).
        held: What holds it back, the most important first.
        optimality: What its certificate says, in a sentence; empty without one.
    """

    T: float
    verified: bool
    bound: LowerBound | None
    seconds: float
    joint_names: tuple[str, ...]
    t: Array
    q: Array
    speed: Array
    torque: Array
    path: Array
    held: tuple[Held, ...]
    optimality: str = ""

    def row(self, time: float) -> int:
        """Index of the instant next to a time [s]."""
        last = self.t.size - 1
        if not self.T > 0.0:
            return last
        return int(np.clip(round(time / self.T * last), 0, last))


@dataclass(frozen=True, eq=False)
class Outcome(Record):
    """What became of a request.

    Attributes:
        number: Number of the request.
        request: The request.
        message: What happened, in a sentence or two.
        shown: The motion; None if there is none.
        final: Whether nothing more will be tried for this request.
    """

    number: int
    request: Request
    message: str
    shown: Shown | None = None
    final: bool = True

    @property
    def ok(self) -> bool:
        """Whether there is a motion that keeps all limits."""
        return self.shown is not None and self.shown.verified


def show(solution: Solution, frame: str, *, certified: bool = False) -> Shown | None:
    """What the page shows of a solution; None if there is no motion.

    Args:
        solution: The solution.
        frame: The frame whose path is drawn.
        certified: Whether what holds the motion comes from its certificate, which
            takes a moment, instead of the samples.
    """
    motion, judged = solution.trajectory, solution.verification
    if motion is None or not solution.success:
        return None
    problem = solution.problem
    t = np.linspace(0.0, motion.duration, INSTANTS)
    at = motion(t)
    speed, torque = used(problem, at.v, at.u)
    kinematics = RobotKinematics(problem.robot)
    path = [kinematics.placement(q, frame).translation for q in at.q]
    held, sentence = None, ""
    if certified:
        held, sentence = _certified(solution)
    return Shown(
        T=motion.duration,
        verified=judged is not None and judged.ok,
        bound=solution.lower_bound,
        seconds=solution.planning_time,
        joint_names=motion.joint_names,
        t=t,
        q=np.array(at.q),
        speed=speed,
        torque=torque,
        path=np.array(path),
        held=_sampled(motion.joint_names, speed, torque) if held is None else held,
        optimality=sentence,
    )


def _sampled(names: tuple[str, ...], speed: Array, torque: Array) -> tuple[Held, ...]:
    """What is at its limit, by share of the time."""
    found = [
        Held(f"{kind} of {name}", share)
        for kind, values in (("speed", speed), ("torque", torque))
        for name, share in zip(
            names, np.mean(np.abs(values) >= AT_LIMIT, axis=0).tolist(), strict=True
        )
        if share > 0.01
    ]
    return tuple(sorted(found, key=lambda item: -item.share)[:MOST_HELD])


# Limits as people call them, by what the certificate calls them.
WORDS = {"effort": "torque", "velocity": "speed", "effort rate": "torque rate"}


def _certified(solution: Solution) -> tuple[tuple[Held, ...] | None, str]:
    """What holds a motion by its certificate, and what that says of the motion."""
    try:
        certificate = solution.certificate
    except ProblemError:
        # Motions that stay somewhere while obstacles move have none.
        return None, ""
    if certificate is None:
        return None, ""
    gains = _gains(solution)
    found = []
    for limit in certificate.active:
        lengths = limit.end - limit.begin
        share = float(np.sum(lengths)) / solution.T
        kind = WORDS.get(limit.kind, limit.kind)
        joins = "between" if limit.kind == "clearance" else "of"
        gain = gains.get((limit.kind, limit.name))
        what = f"{kind} {joins} {limit.name}"
        found.append((gain or 0.0, Held(what, min(share, 1.0), gain)))
    found.sort(key=lambda pair: (-pair[0], -pair[1].share))
    return tuple(held for _, held in found[:MOST_HELD]), certificate.message


def _gains(solution: Solution) -> dict[tuple[str, str], float]:
    """Percent of T that one percent more of each limit would save, by kind and name."""
    try:
        found = solution.sensitivities
    except ProblemError:
        # Motions of several segments have none.
        return {}
    return {
        (item.kind, item.subject): -item.value
        for item in found
        if item.joint is not None and not item.unit
    }
