r"""Sensitivities of the duration of a motion to every limit of its problem.

The duration is the minimum of a program whose limits :math:`g_i(z, p) \le 0` depend on
parameters p: speeds, torques, margins, masses. By the envelope theorem

.. math:: \frac{dT}{dp} = \sum_i \lambda_i \frac{\partial g_i}{\partial p}

at the optimum, with the motion z fixed: no motion is planned again. The multipliers
:math:`\lambda_i` are the multipliers of the certificate.

A displacement of the goal is equivalent to the opposite displacement of the robot.
Therefore the sensitivities to both follow from the values for a robot with a slightly
displaced base and unchanged joint motion; contacts contribute by their normals.

Gravity, payloads, damping and friction change the torques that the same motion
requires, and the wrenches that hold loads. The same limits are evaluated for a robot
with one of these parameters changed. Torques are linear in each of them, so that
differences give their derivatives without a truncation error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, BoolArray
from tominpmp.blas_threads import on_one_thread
from tominpmp.certificate.dual_program import solve_dual_program
from tominpmp.certificate.dwells import without_dwells
from tominpmp.certificate.limits import (
    GOAL,
    PASSIVE,
    SEGMENT,
    LimitRows,
    SampledConstraint,
)
from tominpmp.certificate.motion import GridMotion
from tominpmp.checks import instance
from tominpmp.constraints.base import Constraint
from tominpmp.constraints.torque import MotorLimit, TorqueLimit
from tominpmp.dynamics import RobotDynamics
from tominpmp.exceptions import ProblemError
from tominpmp.goals.place import joint_labels
from tominpmp.kinematics import RobotKinematics, units_of
from tominpmp.motion.samples import Samples
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import EFFORT, HOLDING, SIDES
from tominpmp.problem.joint_limits import (
    JointBounds,
    control_bounds,
    control_kind,
    joint_limits,
)
from tominpmp.problem.problem import Problem
from tominpmp.robot.payload import Payload
from tominpmp.robot.robot import Robot
from tominpmp.sensitivities.records import Sensitivities, Sensitivity, summed
from tominpmp.transcription.problem_functions import ProblemFunctions
from tominpmp.verification.stages import checked_in_segments

# Steps of finite differences: of displacements [m, rad], and of gravity [m/s^2].
STEP, GRAVITY_STEP = 1e-6, 1e-3
# Multiplier up to which a limit is neglected: of clearances [1/m], and of constraints
# in units of their scale.
NOTHING = 1e-9


@on_one_thread
def analyse(problem: Problem, trajectory: Trajectory | Samples) -> Sensitivities:
    """Compute the sensitivities of T to each limit of the problem of a motion.

    Args:
        problem: The problem that the motion solves.
        trajectory: The motion, planned by any method; the closer it is to an optimum
            the more accurate are the values, see :attr:`Sensitivities.promise`.

    Returns:
        The sensitivities; for several segments, the sum over the segments for each
        limit.

    Raises:
        ProblemError: If the motion has other joints than the robot, values that are not
            finite or no multipliers, or if segments have arrival times, or dwells while
            obstacles move.
        ScenarioError: If the samples have other joints than the robot.
    """
    instance(problem, Problem, "problem")
    trajectory = checked_in_segments(problem, trajectory)
    T = trajectory.duration
    check_applicable(problem)
    problem, trajectory = without_dwells(problem.alternative_of(trajectory), trajectory)
    if not trajectory.duration:
        return Sensitivities(T, (), 0.0, np.zeros(6))
    dual = None
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        motion = GridMotion.of(ProblemFunctions.of(problem), trajectory)
        dual = solve_dual_program(motion)
    if dual is None:
        raise ProblemError(
            f"trajectory of {trajectory.duration:.4g} s has no multipliers, expected a "
            "motion whose linear program of small changes can be solved",
            "trajectory",
        )
    # Multipliers are shares of the time without dwells, which are constant.
    share = trajectory.duration / T
    parts = [*_segments(motion, dual.multipliers)]
    records = tuple(item.scaled(share) for part in parts for item in part.records())
    base = np.sum([share * part.base for part in parts], axis=0)
    records = summed(records) if len(parts) > 1 else records
    return Sensitivities(T, records, share * dual.predicted_gain, base)


def check_applicable(problem: Problem, energy_weight: float = 0.0) -> None:
    """Check that sensitivities are known for a problem and its objective.

    Raises:
        ProblemError: If a segment has arrival times, or energy has a weight.
    """
    if energy_weight:
        raise ProblemError(
            f"energy_weight is {energy_weight:g}, expected 0: sensitivities are known "
            "for motions of least T only",
            "energy_weight",
        )
    for number, segment in enumerate(problem.segments, 1):
        if segment.arrival is not None:
            raise ProblemError(
                f"segment {number} has arrival times, expected none: sensitivities to "
                "arrival times are not known",
                f"segments[{number - 1}].arrival",
            )


def _segments(motion: GridMotion, rows: LimitRows) -> Iterator[SegmentRows]:
    """The segments of a motion with their rows, whose subjects are renumbered.

    All segments share a program of small changes, with a duration for each segment.
    Sensitivities are evaluated segment by segment, since robot, payload, limits and
    obstacles differ between segments.
    """
    for number, part in enumerate(motion.segments, 1):
        first, end = part.span
        own = rows.selected((rows.at.interval >= first) & (rows.at.interval < end))
        place = f" of segment {number}" if motion.system.problem.segments else ""
        yield SegmentRows(part, replace(own, subject=own.subject % SEGMENT), place)


@dataclass(frozen=True, eq=False)
class SegmentRows:
    """Sensitivities from the multipliers of a segment of a motion.

    Attributes:
        motion: The motion on the segment.
        rows: The limits of the segment, with their multipliers.
        place: End of the names of goals, which tells the segment; empty for a problem
            without segments.
    """

    motion: GridMotion
    rows: LimitRows
    place: str

    def records(self) -> Iterator[Sensitivity]:
        """Records of all limits and parameters of the segment."""
        yield from self._limits()
        yield from self._clearances()
        yield from self._constraints()
        yield from self._forces()
        yield from self._goal()
        for item in self._problem.scene:
            gradient = self._contacts.get(item.name, np.zeros(6))[:3]
            yield _of_position("obstacle", item.name, gradient)

    @property
    def _problem(self) -> Problem:
        """The problem of the segment."""
        return self.motion.system.problem

    @property
    def _robot(self) -> Robot:
        """The robot of the segment, with its payload."""
        return self._problem.robot

    def _sums(self, kind: str | list[str], values: Array, count: int) -> Array:
        """Sums of values over the rows of a kind, or of several, by subject.

        Shape (count,), or longer up to the last subject that has a row.
        """
        mask = np.isin(self.rows.kind, kind)
        sums = np.bincount(self.rows.subject[mask], values[mask], minlength=count)
        return np.asarray(sums, dtype=float)

    def _of_joint(self, kind: str, joint: int, value: float, *more: Any) -> Sensitivity:
        """Record of a joint; its unit, its limit and the unit of that may follow."""
        name = self._robot.joint_names[joint]
        return Sensitivity(kind, name, name, float(value), *more)

    # -- limits ------------------------------------------------------------------------

    def _limits(self) -> Iterator[Sensitivity]:
        """Records of the joint limits, kind by kind.

        A multiplier is weighted by the share of the limit that the motion uses: then
        the sums satisfy the time scaling identity also for motions away from the
        optimum, as time scaling changes the used shares. Torque limits that differ in
        both directions grow with their middle: shares are counted from the middle.
        """
        rows, system = self.rows, self.motion.system
        # Torques may exceed limits between nodes: their used share is not clipped.
        control = control_kind(self._robot).name
        used = np.where(rows.of(control), rows.used, 1.0 - rows.slack)
        _, strongest = control_bounds(self._robot, self._problem.motion_limits)
        efforts = np.where(system.driven, strongest, np.inf)
        gain, upper = rows.value, rows.upper_active
        for item in joint_limits(self._robot, self._problem.motion_limits):
            kind, most = item.kind, efforts if item.kind.quantity == "u" else item.upper
            units = units_of(self._robot, kind)
            sides = [(kind.name, most, gain * used)]
            if kind.quantity == "q":
                sides = [("upper position", most, gain * upper)]
                sides.append(("lower position", item.lower, gain * ~upper))
            for name, limit, values in sides:
                of = [kind.name, HOLDING.name] if kind.quantity == "u" else kind.name
                value = 0.0 - self._sums(of, values, limit.size)
                if kind.quantity == "u":
                    shift = system.effort_middle / system.effort_half
                    value -= shift * self._sums(of, rows.y, limit.size)
                for j in np.flatnonzero(np.isfinite(limit)).tolist():
                    # Positions may be zero, and have no derivative by a share.
                    per = f"1/{units[j]}" if kind.quantity == "q" else ""
                    size = float(limit[j])
                    yield self._of_joint(name, j, value[j], per, size, units[j])
            for joint in item.by_speed:
                yield from self._over_speed(item, joint)

    def _over_speed(self, item: JointBounds, joint: int) -> Iterator[Sensitivity]:
        """Sensitivities to all parameters of a torque-speed limit."""
        kind, bound = item.kind, item.by_speed[joint]
        motion, rows = self.motion, self.rows
        rows = rows.selected(rows.of(kind.name) & (rows.subject == joint))
        v, u = motion.states(rows.at).v, motion.torques(rows.at)
        each = rows.y / kind.scale(bound, float(motion.system.effort_half[joint]))
        # Far from the optimum, torques of the other sign have multipliers, too.
        side = np.repeat(SIDES, len(item.by_speed))[rows.component]
        shifts = kind.shifts(bound, u[:, joint], v[:, joint], side)
        unit = units_of(self._robot, kind)[joint]
        limit = ("", float(bound), unit) if kind.numbers else ()
        for parameter, by in shifts.items():
            yield self._of_joint(parameter, joint, -float(each @ by), *limit)

    def _clearances(self) -> Iterator[Sensitivity]:
        """Clearances by obstacle, by pair of links, and the margin of all pairs."""
        problem, checker = self._problem, self._problem.checker
        gain = self._sums("clearance", self.rows.value, len(checker.pairs))
        names: dict[str, float] = {item.name: 0.0 for item in problem.scene}
        for index in np.flatnonzero(gain > 0.0).tolist():
            link, other = checker.pairs[index]
            own = index >= checker.obstacle_pairs
            name = f"{link} and {other}" if own else other
            names[name] = names.get(name, 0.0) + float(gain[index])
        for name, value in names.items():
            yield Sensitivity("clearance", None, name, value, "1/m")
        margin = float(gain[checker.margins(1.0) > 0.0].sum())
        value, unit = _by_share(margin, problem.margin, "m")
        limit = max(problem.margin, 0.0)
        yield Sensitivity("margin", None, "", value, unit, limit, "m")

    def _constraints(self) -> Iterator[Sensitivity]:
        """Records of the constraints of the problem along the motion."""
        items = self._problem.constraints
        for index, item in enumerate(items):
            gain = float(self._sums(item.name, self.rows.value, len(items))[index])
            limit, per = float(item.largest), item.unit
            value, unit = _by_share(0.0 - gain, limit, per)
            yield Sensitivity(item.name, None, item.subject, value, unit, limit, per)

    # -- parameters of the robot -------------------------------------------------------

    def _cost(self, robot: Robot) -> float:
        """Sum of the limited quantities for a changed robot, by multipliers.

        The motion remains; the torques that it requires and the values of constraints
        change, but neither clearances nor goals.
        """
        motion, every = self.motion, self.rows
        problem = self._problem._altered("ready_constraints", robot=robot)
        dynamics = RobotDynamics(robot, dry=False)
        system = replace(
            motion.system, problem=problem, dynamics=dynamics, clearance_rows=None
        )
        items: list[tuple[Constraint, BoolArray]] = []
        for limit in system.constraints:
            if isinstance(limit, MotorLimit):
                passive = (PASSIVE,) if isinstance(limit, TorqueLimit) else ()
                items.append((limit, every.of(limit.kind.name, *passive)))
        if system.held is not None:
            items.append((system.held, every.of(system.held.name)))
        for index, item in enumerate(problem.ready_constraints):
            items.append((item, every.of(item.name) & (every.subject == index)))
        total = 0.0
        for constraint, mine in items:
            rows = every.selected(mine & (every.y != 0.0))
            if rows.y.size:
                slopes = constraint.order > 2
                at = motion.changes.pairs(rows.at.interval) if slopes else rows.at
                values = SampledConstraint.of(motion, constraint, at).values
                total += float(rows.y @ values[np.arange(rows.y.size), rows.component])
        return total

    def _forces(self) -> Iterator[Sensitivity]:
        """Records of gravity, payloads, damping and dry friction."""
        robot, cost = self._robot, self._cost(self._robot)
        by_gravity = _slopes(self._cost, partial(_pulled, robot), 3, GRAVITY_STEP)
        size = float(np.linalg.norm(robot.gravity))
        value = float(by_gravity @ robot.gravity)
        yield Sensitivity("gravity", None, "", value, "", size, "m/s^2", by_gravity)
        for item in robot.payloads:
            more = self._cost(_loaded(robot, item)) - cost
            value, unit = _by_share(more, item.mass, "kg")
            yield Sensitivity("payload", None, item.name, value, unit, item.mass, "kg")
        viscous = ["N s/m" if u == "m" else "N m s/rad" for u in units_of(robot)]
        for kind, coefficient, units in (
            ("damping", robot.damping, viscous),
            ("friction", robot.friction, units_of(robot, EFFORT)),
        ):
            for j in np.flatnonzero(coefficient).tolist():
                doubled = coefficient * (1.0 + np.eye(robot.n)[j])
                value = self._cost(replace(robot, **{kind: doubled})) - cost
                size = float(coefficient[j])
                yield self._of_joint(kind, j, value, "", size, units[j])

    # -- positions of the goal, of obstacles and of the base ---------------------------

    def _goal(self) -> Iterator[Sensitivity]:
        """Records of the goal: of positions of joints one by one, or of a place."""
        goal, rest = self._problem.goal, np.zeros(self._robot.n)
        # Where all positions are zero, the values of joints are minus their goals.
        place = goal.place(self.motion.system.kinematics, rest)
        joints = {label: joint for joint, label in enumerate(joint_labels(self._robot))}
        values = 0.0 - self._sums(GOAL, self.rows.y, place.value.size)
        for row, label in enumerate(place.labels):
            if label in joints:
                at = f"1/{label.unit}", 0.0 - float(place.value[row]), label.unit
                item = self._of_joint("goal", joints[label], values[row], *at)
                yield replace(item, subject=item.subject + self.place)
        if not joints.keys() >= set(place.labels):
            name = goal.frame_name
            subject = "goal" if name is None else f"frame {name}"
            yield _of_position("goal", subject + self.place, -self._base_of_goal[:3])

    def _by_base(self, cost: Callable[[Robot], float]) -> Array:
        """Derivatives of a cost by a displacement of the base, shape (6,)."""
        return _slopes(cost, partial(_displaced, self._robot), 6, STEP)

    @cached_property
    def _base_of_goal(self) -> Array:
        """Derivatives of ln T by a displacement of the base, through the goal, (6,)."""
        y, node = self._sums(GOAL, self.rows.y, 0), self.motion.span[1]
        goal = self._problem.goal
        if goal.configuration is not None or not y.size:
            return np.zeros(6)
        state = self.motion.changes.q[node], self.motion.changes.v[node]

        def cost(robot: Robot) -> float:
            return float(y @ goal.residual(RobotKinematics(robot), *state).value)

        return self._by_base(cost)

    @cached_property
    def _contacts(self) -> dict[str, Array]:
        """Derivatives of ln T by displacements of obstacles, by name.

        Three translations [1/m] and three rotations about the origin of the world
        [1/rad], shape (6,) each.
        """
        checker, rows = self._problem.checker, self.rows
        obstacles = rows.of("clearance") & (rows.subject < checker.obstacle_pairs)
        rows = rows.selected(obstacles & (rows.y > NOTHING * rows.unit))
        out: dict[str, Array] = {}
        times, pairs = rows.at.times(self.motion.changes.h), rows.subject
        q = self.motion.trajectory(times, 0)
        normal, _, point = checker.witnesses(q, np.arange(len(q)), pairs, times)
        # Clearance grows if an obstacle moves along the normal.
        twists = np.hstack([normal, np.cross(point, normal)]) * -rows.value[:, None]
        for pair, twist in zip(pairs.tolist(), twists, strict=True):
            name = checker.pairs[pair][1]
            out[name] = out.get(name, np.zeros(6)) + twist
        return out

    @cached_property
    def base(self) -> Array:
        """Derivatives of ln T by a displacement of the base, (6,) [1/m, 1/rad]."""
        by_contacts = sum(self._contacts.values(), np.zeros(6))
        return self._base_of_goal - by_contacts + self._by_base(self._cost)


def _by_share(value: float, limit: float, unit: str) -> tuple[float, str]:
    """Sensitivity to a share of a limit, or to its unit if the limit is not positive.

    Args:
        value: Derivative of ln T with respect to the limit.
        limit: The limit.
        unit: Unit of the limit.

    Returns:
        The sensitivity and its unit.
    """
    return (value * limit, "") if limit > 0.0 else (value, f"1/{unit}")


def _slopes(
    cost: Callable[[Robot], float],
    change: Callable[[Array], Robot],
    coordinates: int,
    step: float,
) -> Array:
    """Derivatives of a cost by coordinates of a change of the robot.

    Args:
        cost: The cost of a robot.
        change: The robot changed by coordinates.
        coordinates: Number of coordinates.
        step: Step of the central differences.
    """
    steps = step * np.eye(coordinates)
    ends = [[cost(change(sign * x)) for sign in (-1.0, 1.0)] for x in steps]
    return np.diff(ends)[:, 0] / (2.0 * step)


def _pulled(robot: Robot, pull: Array) -> Robot:
    """The robot with an additional gravity."""
    model = robot.model.copy()
    model.gravity.linear = model.gravity.linear + pull
    return replace(robot, model=model)


def _loaded(robot: Robot, payload: Payload) -> Robot:
    """The robot with another kilogram of a payload.

    The payload keeps its centre of mass and its radii of gyration.
    """
    tensor = np.zeros((3, 3)) if payload.inertia is None else payload.inertia
    if payload.mass > 0.0:
        tensor = np.asarray(tensor) / payload.mass
    unit = pin.Inertia(1.0, np.array(payload.com), np.array(tensor))
    model = robot.model.copy()
    frame = model.frames[robot.frame_id(payload.name)]
    model.inertias[frame.parentJoint] += frame.placement.act(unit)
    return replace(robot, model=model)


def _displaced(robot: Robot, twist: Array) -> Robot:
    """The robot with its base displaced by a small twist in the world.

    The shapes of the links are not displaced.
    """
    model = robot.model.copy()
    move = pin.SE3(pin.exp3(twist[3:]), twist[:3])
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = move * model.jointPlacements[joint]
    for frame in model.frames:
        if frame.parentJoint == 0:
            frame.placement = move * frame.placement
    return replace(robot, model=model)


def _of_position(kind: str, subject: str, gradient: Array) -> Sensitivity:
    """Record of a position, from the derivatives of ln T with respect to it."""
    length = float(np.linalg.norm(gradient))
    return Sensitivity(kind, None, subject, length, "1/m", vector=gradient)
