"""Planning for the page: from the last motion, then proofs, then a second look.

Outcomes are plain data, few enough to pass on at once: numbers that the page shows.
"""

from __future__ import annotations

import pickle
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tominpmp.app.request import Request
from tominpmp.arrays import Array, Record
from tominpmp.bounds.result import LowerBound
from tominpmp.exceptions import ProblemError, TominpmpError, TominpmpWarning
from tominpmp.files.export_check import check_export
from tominpmp.kinematics import FrameMotions
from tominpmp.planner.planning import plan
from tominpmp.problem.problem import Problem
from tominpmp.solution import Solution
from tominpmp.status import IterationRecord
from tominpmp.viz.shares import AT_LIMIT, Shares, shares_of_limits

# Nobody waits longer for a page [s].
MOST_SECONDS = 20.0
# A motion found afresh takes the place of the one shown if it is faster by this share.
BETTER = 1e-3
# Instants at which a motion is shown.
INSTANTS = 241
# Largest number of limits that are listed as holding a motion back.
MOST_HELD = 8
# Limits as people call them, by what the certificate calls them.
WORDS = {"effort": "torque", "velocity": "speed", "effort rate": "torque rate"}


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
class Shown(Shares):
    """A motion as it is shown, at instants evenly spaced.

    Attributes:
        q: Configurations, shape (m, n) [rad or m].
        path: Positions of the frame [m], shape (m, 3).
        verified: Whether an independent replay of the torques meets goal and limits.
        bound: Time that no motion can beat; None if it is not known.
        seconds: How long planning took [s].
        held: What holds it back, the most important first.
        optimality: What its certificate says, in a sentence; empty without one.
    """

    q: Array
    path: Array
    verified: bool
    bound: LowerBound | None
    seconds: float
    held: tuple[Held, ...]
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
    """What became of a request.

    Attributes:
        number: Number of the request.
        request: The request.
        message: What happened, in a sentence or two.
        shown: The motion; None if there is none.
        final: Whether nothing more will be tried for this request.
        solution: The solution for files, pickled: it is read only if one is wanted.
    """

    number: int
    request: Request
    message: str
    shown: Shown | None = None
    final: bool = True
    solution: bytes = b""

    @property
    def ok(self) -> bool:
        """Whether there is a motion that keeps all limits."""
        return self.shown is not None and self.shown.verified


class Superseded(Exception):
    """The request that is planned for is out of date."""


class Session:
    """Plans one request after the other, each from the motion found before.

    Attributes:
        solution: The last motion that was found; None before the first.
    """

    def __init__(self) -> None:
        self.solution: Solution | None = None

    def outcomes(
        self, number: int, request: Request, superseded: Callable[[], bool]
    ) -> Iterator[Outcome]:
        """Plan, and yield each outcome as soon as it is found.

        A motion is shown first, then what holds it back; where it came from a former
        one, a faster one is looked for afresh.

        Args:
            number: Number of the request, for its outcomes.
            request: What is asked for.
            superseded: Tells whether the request is out of date, which ends it.
        """

        def check(_: IterationRecord | None = None) -> None:
            if superseded():
                raise Superseded

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TominpmpWarning)
            try:
                for solution, certified, final in self._found(request, check):
                    shown = _shown(solution, request.frame, certified)
                    saved, message = pickle.dumps(solution), solution.message
                    yield Outcome(number, request, message, shown, final, saved)
            except Superseded:
                return
            except TominpmpError as error:
                yield Outcome(number, request, str(error))

    def _found(
        self, request: Request, check: Callable[..., None]
    ) -> Iterator[tuple[Solution, bool, bool]]:
        """Solutions, whether to certify them, and whether nothing more is tried.

        Raises:
            Superseded: As soon as the request is out of date.
            TominpmpError: If the request is wrong, or no motion was found.
        """
        problem = request.problem()
        former = self._former(problem)
        found = _plan(problem, check, former)
        if not found.success:
            raise TominpmpError(found.message)
        self.solution = found
        yield found, False, False
        check()
        yield found, True, former is None
        if former is None:
            return
        check()
        again = _plan(problem, check)
        if again.success and again.T < (1.0 - BETTER) * found.T:
            self.solution = found = again
        yield found, True, True

    def _former(self, problem: Problem) -> Solution | None:
        """The last motion, if one can begin with it."""
        last = self.solution
        if last is None or len(problem.segments) != len(last.problem.segments):
            return None
        same = last.problem.robot.joint_names == problem.robot.joint_names
        return last if same else None


def _plan(
    problem: Problem,
    look: Callable[[IterationRecord], None],
    former: Solution | None = None,
) -> Solution:
    """Plan quickly."""
    solution = plan(
        problem,
        start=former,
        effort="quick",
        max_planning_time=MOST_SECONDS,
        callback=look,
    )
    # The solution that is kept needs no callback, which refers to this request.
    return replace(solution, options=replace(solution.options, callback=None))


def exported(
    solution: Solution, ending: str, dt: float | None, message: str | None = None
) -> tuple[str, bytes, str]:
    """Write a motion to a file.

    Args:
        solution: Its solution.
        ending: What the file's name ends with: ".csv", ".npz", ".yaml", ...
        dt: Time between rows [s]; None for the nodes.
        message: Which ROS message, if it is one.

    Returns:
        Name and content of the file, and what its check says.

    Raises:
        TominpmpError: If the file cannot be written.
    """
    with tempfile.TemporaryDirectory(prefix="tominpmp-") as folder:
        name = f"{plain_name(solution.problem.robot.name)}_motion{ending}"
        path = Path(folder) / name
        solution.export(path, dt=dt, message=message, verify=False)
        return name, path.read_bytes(), check_export(solution, path, dt=dt).message


def plain_name(name: str) -> str:
    """A name that any file system takes."""
    plain = "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    return plain[:60] or "robot"


def _shown(solution: Solution, frame: str, certified: bool) -> Shown:
    """What the page shows of a motion.

    Args:
        solution: The solution, which has one.
        frame: The frame whose path is drawn.
        certified: Whether what holds the motion comes from its certificate, which
            takes a moment, instead of the samples.
    """
    motion, judged = solution.trajectory, solution.verification
    assert motion is not None  # noqa: S101
    shares = shares_of_limits(
        solution.problem, motion, np.linspace(0.0, motion.duration, INSTANTS)
    )
    q = motion(shares.t).q
    path = FrameMotions(solution.problem.robot, frame).placements(q).origin
    held, sentence = _certified(solution) if certified else (None, "")
    if held is None:
        held = _sampled(shares)
    return Shown(
        **vars(shares),
        q=np.array(q),
        path=path,
        verified=judged is not None and judged.ok,
        bound=solution.lower_bound,
        seconds=solution.planning_time,
        held=tuple(held[:MOST_HELD]),
        optimality=sentence,
    )


def _sampled(shares: Shares) -> list[Held]:
    """Speeds and torques at their limits, by share of the time."""
    found = []
    for kind, values in (("speed", shares.speed), (shares.control, shares.torque)):
        often = np.mean(np.abs(values) >= AT_LIMIT, axis=0).tolist()
        found += [
            Held(f"{kind} of {name}", share)
            for name, share in zip(shares.joint_names, often, strict=True)
            if share > 0.01
        ]
    return sorted(found, key=lambda item: -item.share)


def _certified(solution: Solution) -> tuple[list[Held] | None, str]:
    """What holds a motion by its certificate, and what that says of the motion.

    Gains are percent of T that one percent more of a limit would save.
    """
    certificate, gains = None, dict[tuple[str, str], float]()
    with suppress(ProblemError):
        # Motions that dwell while obstacles move have no certificate.
        certificate = solution.certificate
    if certificate is None:
        return None, ""
    with suppress(ProblemError):
        # Motions of several segments have no sensitivities.
        gains = {
            (item.kind, item.subject): -item.value
            for item in solution.sensitivities
            if item.joint is not None and not item.unit
        }
    found = []
    for limit in certificate.active:
        share = float(np.sum(limit.end - limit.begin)) / solution.T
        joins = "between" if limit.kind == "clearance" else "of"
        what = f"{WORDS.get(limit.kind, limit.kind)} {joins} {limit.name}"
        gain = gains.get((limit.kind, limit.name))
        found.append(Held(what, min(share, 1.0), gain))
    found.sort(key=lambda item: (-(item.gain or 0.0), -item.share))
    return found, certificate.message
