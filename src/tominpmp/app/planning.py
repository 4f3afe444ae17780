"""Planning for the page: a warm start, then the certificate, then a cold start.

Outcomes are plain data, small enough to be sent between processes at once.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from tominpmp.app.request import Request
from tominpmp.arrays import Array, Record
from tominpmp.bounds.result import LowerBound
from tominpmp.exceptions import ProblemError, TominpmpError, quiet
from tominpmp.kinematics import FrameMotions
from tominpmp.motion.measures import SATURATED
from tominpmp.options import Options
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import IterationRecord
from tominpmp.viz.shares import Shares, shares_of_limits

# Time limit of a plan [s].
MOST_SECONDS = 20.0
# Least gain of a cold start over a warm start, as a share of T, to replace its motion.
BETTER = 1e-3
# Instants at which a motion is sampled for display.
INSTANTS = 241
# Largest number of active limits that are listed, and the least share of the time in
# which one is active, or the least gain [%].
MOST_ACTIVE, LEAST_SHARE, LEAST_GAIN = 8, 0.01, 0.005
# Names of limits on the page, by their names in the certificate.
WORDS = {"effort": "torque", "velocity": "speed", "effort rate": "torque rate"}


@dataclass(frozen=True)
class BindingLimit:
    """An active limit of a motion.

    Attributes:
        name: The limit, in words: "torque of panda_joint2".
        share: Share of the time in which the limit is active.
        gain: Percent of T that one percent more of the limit would save, to first
            order; None if it is unknown, or percents have no meaning (clearance).
    """

    name: str
    share: float
    gain: float | None = None


@dataclass(frozen=True, eq=False)
class ShownMotion(Shares):
    """A motion for display, sampled at evenly spaced instants.

    Attributes:
        q: Configurations, shape (m, n) [rad or m].
        path: Positions of the frame [m], shape (m, 3).
        verified: Whether an independent replay of the torques meets goal and limits.
        bound: Lower bound of T; None if it is not known.
        seconds: Time that planning took [s].
        active: Its active limits, the most important first.
        solution: The pickled solution, which is read only to export the motion.
        optimality: Message of its certificate; empty without a certificate.
    """

    q: Array
    path: Array
    verified: bool
    bound: LowerBound | None
    seconds: float
    active: tuple[BindingLimit, ...]
    solution: bytes
    optimality: str = ""

    @property
    def T(self) -> float:
        """Its duration [s]."""
        return float(self.t[-1])

    def row(self, time: float) -> int:
        """Index of the instant next to a time [s]."""
        return int(np.argmin(np.abs(self.t - time)))


@dataclass(frozen=True, eq=False)
class Outcome(Record):
    """The result of planning a request.

    Attributes:
        request: The request.
        message: Message of the solution, or of an error.
        shown: The motion for display; None without a motion.
        final: Whether this is the last outcome of the request.
    """

    request: Request
    message: str
    shown: ShownMotion | None = None
    final: bool = True


class _Superseded(Exception):
    """Raised when a newer request has replaced the one that is planned."""


class Session:
    """Plans one request after the other, each warm-started with the last motion.

    Attributes:
        solution: The last motion that was found; None before the first.
    """

    def __init__(self) -> None:
        self.solution: Solution | None = None

    def outcomes(
        self, request: Request, superseded: Callable[[], bool]
    ) -> Iterator[Outcome]:
        """Plan, and yield each outcome as soon as it is found.

        The first outcome has the motion, the second its active limits by the
        certificate; after a warm start a cold start looks for a faster motion.

        Args:
            request: The request.
            superseded: Whether a newer request has come, which ends a plan; between
                outcomes the caller ends the planning.
        """

        def check(_: IterationRecord) -> None:
            if superseded():
                raise _Superseded

        with quiet(), suppress(_Superseded):
            try:
                for solution, certified, final in self._solutions(request, check):
                    shown = _shown(solution, request.frame, certified)
                    yield Outcome(request, solution.message, shown, final)
            except TominpmpError as error:
                yield Outcome(request, str(error))

    def _solutions(
        self, request: Request, check: Callable[[IterationRecord], None]
    ) -> Iterator[tuple[Solution, bool, bool]]:
        """Solutions, whether to certify each, and whether it is the last one.

        Raises:
            _Superseded: If a newer request comes during a plan.
            TominpmpError: If the request is wrong, or no motion was found.
        """
        problem = request.problem()
        options = Options(
            effort="quick", max_planning_time=MOST_SECONDS, callback=check
        )
        former = self._former(problem)
        solution = plan(problem, options, former)
        if not solution.success:
            raise TominpmpError(solution.message)
        self.solution = solution
        yield solution, False, False
        yield solution, True, former is None
        if former is None:
            return
        again = plan(problem, options)
        if again.success and again.T < (1.0 - BETTER) * solution.T:
            self.solution = solution = again
        yield solution, True, True

    def _former(self, problem: Problem) -> Solution | None:
        """The last solution, if it can be a warm start; otherwise None."""
        last = self.solution
        if last is None or len(problem.segments) != len(last.problem.segments):
            return None
        same = last.problem.robot.joint_names == problem.robot.joint_names
        return last if same else None


def plain_name(name: str) -> str:
    """A name that is valid on every file system."""
    plain = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    return plain[:60] or "robot"


def _shown(solution: Solution, frame: str, certified: bool) -> ShownMotion:
    """Sample a motion for display.

    Args:
        solution: The solution, which has a motion.
        frame: The frame whose path is drawn.
        certified: Whether the active limits come from the certificate, which takes a
            moment to compute, instead of the samples.
    """
    motion = solution.trajectory
    shares = shares_of_limits(
        solution.problem, motion, np.linspace(0.0, motion.duration, INSTANTS)
    )
    q = motion(shares.t).q
    path = FrameMotions(solution.problem.robot, frame).placements(q).origin
    active, message = _certified(solution) if certified else (_sampled(shares), "")
    return ShownMotion(
        **vars(shares),
        q=np.array(q),
        path=path,
        verified=bool(solution.verification),
        bound=solution.lower_bound,
        seconds=solution.planning_time,
        active=tuple(active[:MOST_ACTIVE]),
        solution=pickle.dumps(solution),
        optimality=message,
    )


def _sampled(shares: Shares) -> list[BindingLimit]:
    """Saturated speeds and torques of samples, by decreasing share of the time."""
    active = []
    for kind, values in (("speed", shares.speed), (shares.control, shares.torque)):
        saturated = np.mean(np.abs(values) >= SATURATED, axis=0).tolist()
        active += [
            BindingLimit(f"{kind} of {name}", share)
            for name, share in zip(shares.joint_names, saturated, strict=True)
            if share > LEAST_SHARE
        ]
    return sorted(active, key=lambda item: -item.share)


def _certified(solution: Solution) -> tuple[list[BindingLimit], str]:
    """Active limits by the certificate, and its message.

    Gains are percent of T that one percent more of a limit would save.
    """
    certificate, gains = solution.certificate, dict[tuple[str, str], float]()
    with suppress(ProblemError):
        # Motions without multipliers have no sensitivities.
        gains = {
            (item.kind, item.subject): -item.value
            for item in solution.sensitivities
            if item.joint is not None and not item.unit
        }
    active = []
    for limit in certificate.active:
        share = float(np.sum(limit.end - limit.begin)) / solution.T
        joins = "between" if limit.kind == "clearance" else "of"
        name = f"{WORDS.get(limit.kind, limit.kind)} {joins} {limit.name}"
        gain = gains.get((limit.kind, limit.name))
        if share > LEAST_SHARE or (gain or 0.0) >= LEAST_GAIN:
            active.append(BindingLimit(name, min(share, 1.0), gain))
    active.sort(key=lambda item: (-(item.gain or 0.0), -item.share))
    return active, certificate.message
