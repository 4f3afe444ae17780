"""Limits of controllers and motors beyond those of a robot description file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, Record, array_or_nan, record
from tominpmp.checks import (
    HUGE,
    TINY,
    array,
    by_joint,
    choice,
    instance,
    known_joints,
    non_negative,
    number,
    one_per_joint,
    positive,
    vector,
    whole,
    wrong,
)
from tominpmp.checks import names as joints_named
from tominpmp.exceptions import ProblemError, naming

PerJoint: TypeAlias = "float | ArrayLike | Mapping[str, float] | None"


Row: TypeAlias = Annotated[
    Converted[ArrayLike, Array], partial(vector, expected="a row of numbers")
]


@record
class EffortCurve(Record):
    """Largest torque of a motor over its speed, piecewise linear.

    Attributes:
        speed: Absolute speeds, from 0, increasing, shape (k,) [rad/s or m/s].
        effort: Largest torque at these speeds, shape (k,) [N m or N]; constant beyond
            the last speed.
    """

    speed: Row
    effort: Row

    def __post_init__(self) -> None:
        """Check the curve."""
        with naming("effort curve"):
            super().__post_init__()
            count = self.speed.size
            if self.effort.size != count or count < 2:
                expected = f"a torque for each of {count} speeds, two at least"
                raise wrong(self.effort.tolist(), "effort", expected)
            if self.speed[0] != 0.0 or np.any(np.diff(self.speed) <= 0.0):
                raise wrong(self.speed.tolist(), "speed", "speeds that increase from 0")
            if np.any(self.effort < 0.0):
                raise wrong(self.effort.tolist(), "effort", "torques >= 0")

    @classmethod
    def droop(cls, stall: float, no_load_speed: float) -> EffortCurve:
        """Linear droop of a direct-current motor: no torque at the no-load speed."""
        top = positive(no_load_speed, "no_load_speed", "rad/s or m/s")
        torque = non_negative(stall, "stall", "N m or N")
        return cls(np.array([0.0, top]), np.array([torque, 0.0]))

    @classmethod
    def power(
        cls, effort: float, power: float, top_speed: float, points: int = 12
    ) -> EffortCurve:
        """Constant torque up to a power limit [W], tangents of the hyperbola beyond.

        The power is at most the limit, and with the usual 12 points at least 99 % of it
        if the top speed is up to nine times the speed at which the limit begins.
        """
        effort = positive(effort, "effort", "N m or N")
        knee = positive(power, "power", "W") / effort
        top_speed = positive(top_speed, "top_speed", "rad/s or m/s")
        count = whole(points, "points", least=2)
        if top_speed <= knee:
            return cls(np.array([0.0, knee]), np.array([effort, effort]))
        touched = np.geomspace(knee, top_speed, count)
        mean = 0.5 * (touched[:-1] + touched[1:])
        # Neighbouring tangents meet at the harmonic mean of the speeds they touch at.
        corners = touched[:-1] * touched[1:] / mean
        speed = np.concatenate([[0.0, knee], corners, [top_speed]])
        torque = np.concatenate([[effort, effort], power / mean, [power / top_speed]])
        return cls(speed, torque)

    def __call__(self, speed: Array) -> tuple[Array, Array]:
        """Largest torques and their slopes over |speed|, for speeds of any shape."""
        magnitude = np.abs(array(speed, "speed", (...,), "speeds"))
        value = np.interp(magnitude, self.speed, self.effort)
        slopes = np.append(np.diff(self.effort) / np.diff(self.speed), 0.0)
        piece = np.searchsorted(self.speed, magnitude, side="right") - 1
        return value, slopes[np.minimum(piece, slopes.size - 1)]


# Signs of the upper and the lower side of a bound.
SIDES = (1.0, -1.0)


@dataclass(frozen=True)
class LimitKind:
    """A kind of limit that has a bound for each joint.

    Planner, replay, certificate, sensitivities and files iterate over all kinds, and
    name none of them. To add a kind, make an instance of this class, or of a subclass
    with an excess function, and a field of motion limits that holds its bounds.

    Attributes:
        name: Its name in messages, reports and records.
        units: Units of its bounds, for revolute and for prismatic joints.
        quantity: Bounded quantity: "q", "v", "a" or "u" for positions, velocities,
            accelerations or torques; "j" or "du" for rates of accelerations or torques;
            "uv" for a function of torques and velocities.
        order: Power of the factor by which the quantity falls if time is stretched by
            that factor; for quantities that do not depend on torques, the order of the
            derivative.
        part_of: Name of the kind under which a replay counts it; empty for its own
            name.
        numbers: Whether its bounds are numbers.
    """

    name: str
    units: tuple[str, str]
    quantity: str
    order: int
    part_of: str = ""
    numbers: ClassVar[bool] = True

    @property
    def smooth(self) -> bool:
        """Whether only motions whose accelerations do not jump can keep the limit."""
        return self.quantity in ("j", "du")

    @property
    def of_torques(self) -> bool:
        """Whether it bounds torques, or a quantity that depends on them."""
        return self.quantity in ("u", "du", "uv")

    @property
    def unit(self) -> str:
        """Its units, as a phrase."""
        return " or ".join(dict.fromkeys(self.units))

    def checked(self, value: object, key: str, joint: str | None = None) -> Any:
        """Check and convert the bound of a joint, or the bounds of all joints.

        Args:
            value: The caller's value: a number, or for all joints also an array.
            key: The field of motion limits.
            joint: The joint; None for all joints.

        Raises:
            ProblemError: If a bound is not a positive number.
        """
        bounds = array_or_nan(value)
        known = (TINY <= bounds) & ((bounds <= HUGE) | (bounds == np.inf))
        if bounds.ndim > (joint is None) or not np.all(known):
            name = key if joint is None else f"{key}: joint {joint!r}"
            message = str(wrong(value, name, f"positive numbers [{self.unit}]"))
            raise ProblemError(message, key)
        return bounds if joint is None else float(bounds)

    def excess(
        self, bound: Any, u: Array, v: Array, side: float | Array
    ) -> tuple[Array, Array, Array]:
        """Excess of the torques and velocities of a joint over a bound ("uv").

        Args:
            bound: The bound.
            u: Torques, of any shape.
            v: Velocities, of the same shape.
            side: 1.0 for the upper side, -1.0 for the lower one; also one per torque.

        Returns:
            The excess, and its derivatives by torque and by velocity.
        """
        raise NotImplementedError

    def largest_excess(self, bound: Any, u: Array, v: Array) -> Array:
        """Excess over a bound on the side with the larger excess ("uv")."""
        upper, lower = (self.excess(bound, u, v, side)[0] for side in SIDES)
        return np.asarray(np.maximum(upper, lower))

    def scale(self, bound: Any, half: float) -> float:
        """Scale of relative excesses: the bound, or half the range of torques."""
        return float(bound) if self.numbers else half

    def shifts(self, bound: Any, u: Array, v: Array, side: Array) -> dict[str, Array]:
        """Decrease of the excess per relative increase of a bound ("uv").

        Returns:
            Decreases by the name that sensitivities give to the bound.
        """
        return {self.name: self.excess(bound, u, v, side)[0] + bound}


class EffortOverSpeed(LimitKind):
    """Torque limits that are curves over the speed."""

    numbers = False

    def checked(self, value: object, key: str, joint: str | None = None) -> Any:
        """Check the curve of a joint."""
        if joint is None:
            raise wrong(value, key, "EffortCurves by joint name")
        return instance(value, EffortCurve, f"{key}: joint {joint!r}", field=key)

    def excess(
        self, bound: Any, u: Array, v: Array, side: float | Array
    ) -> tuple[Array, Array, Array]:
        """Excess of torques over the curve."""
        most, slope = bound(v)
        return side * u - most, np.full(u.shape, side), -slope * np.sign(v)

    def shifts(self, bound: Any, u: Array, v: Array, side: Array) -> dict[str, Array]:
        """Decreases of the excess per relative increase of either axis of the curve."""
        falls = bound(v)[1] * np.abs(v)
        return {self.name: side * u, "speed of effort curve": -falls}


# Kinds of the limits that all robots have.
POSITION = LimitKind("position", ("rad", "m"), "q", 0)
VELOCITY = LimitKind("velocity", ("rad/s", "m/s"), "v", 1)
EFFORT = LimitKind("effort", ("N m", "N"), "u", 2)
# Bounds the torques that a feedback adds in a replay.
FEEDBACK = replace(EFFORT, name="feedback")
# Bounds the torques that hold the arm at rest at its goal.
HOLDING = replace(EFFORT, name="holding torque")
# Kinds of the fields of motion limits.
ACCELERATION = LimitKind("acceleration", ("rad/s^2", "m/s^2"), "a", 2)
# Acceleration limit of kinematic robots, whose controls are accelerations.
CONTROL_ACCELERATION = replace(ACCELERATION, quantity="u")
JERK = LimitKind("jerk", ("rad/s^3", "m/s^3"), "j", 3)
EFFORT_RATE = LimitKind("effort rate", ("N m/s", "N/s"), "du", 3)
OVER_SPEED = EffortOverSpeed("effort over speed", EFFORT.units, "uv", 2, EFFORT.name)


def kinds_of(
    limits: type[MotionLimits] | MotionLimits, *, numbers: bool = False
) -> dict[str, LimitKind]:
    """Kinds of limits by the fields with their bounds.

    Args:
        limits: The limits, or a class of them.
        numbers: Whether to list only the kinds whose bounds are numbers.
    """
    known = ((item.name, item.metadata.get("kind")) for item in fields(limits))
    return {k: kind for k, kind in known if kind and (kind.numbers or not numbers)}


@dataclass(frozen=True, eq=False)
class MotionLimits(Record):
    """Limits beyond those of a robot description file.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some of the joints; None or infinity is no limit.

    Where jerks or torque rates are limited, accelerations do not jump: a motion begins
    with those of the problem (``a_start``), which are zero by default, and ends with
    zero.

    Attributes:
        acceleration: Largest acceleration [rad/s^2 or m/s^2].
        jerk: Largest jerk [rad/s^3 or m/s^3].
        effort_rate: Largest torque rate [N m/s or N/s] (paper, section 4).
        effort_scale: Share of the torque limits that the motion may use; the rest is a
            reserve for the feedback controller.
        effort_curves: Torque over speed by joint name.
    """

    acceleration: PerJoint = field(default=None, metadata={"kind": ACCELERATION})
    jerk: PerJoint = field(default=None, metadata={"kind": JERK})
    effort_rate: PerJoint = field(default=None, metadata={"kind": EFFORT_RATE})
    effort_scale: float = 1.0
    effort_curves: Mapping[str, EffortCurve] | None = field(
        default_factory=dict, metadata={"kind": OVER_SPEED}
    )

    def __post_init__(self) -> None:
        """Make the checks that need no robot."""
        expected = "a share in (0, 1]"
        scale = number(self.effort_scale, "effort_scale", expected, above=0.0, most=1.0)
        curves = {} if self.effort_curves is None else self.effort_curves
        self._keep(effort_scale=scale, effort_curves=curves)
        for name, kind in kinds_of(self).items():
            value = by_joint(getattr(self, name)) or getattr(self, name)
            if isinstance(value, Mapping):
                each = {k: kind.checked(v, name, k) for k, v in value.items()}
                self._keep(**{name: each})
            elif value is not None:
                self._keep(**{name: kind.checked(value, name)})

    def _bounds_of(self, name: str, joint_names: Sequence[str]) -> dict[str, Any]:
        """Bounds in a field by joint name, of the joints that have one."""
        value, n = getattr(self, name, None), len(joint_names)
        if value is None:
            return {}
        if isinstance(value, Mapping):
            known_joints(value, joint_names, name)
            return dict(value)
        if value.ndim == 1:
            one_per_joint(value, name, joint_names)
        return dict(zip(joint_names, np.broadcast_to(value, n).tolist(), strict=True))

    def by_joint(self, name: str, joint_names: Sequence[str]) -> Array:
        """Bounds of the joints of a robot, infinite for no limit, shape (n,).

        Args:
            name: "acceleration", "jerk" or "effort_rate".
            joint_names: Names of the joints.

        Raises:
            ProblemError: If there are too many or too few values.
            JointNotFound: If a joint is unknown.
        """
        known = tuple(kinds_of(self, numbers=True))
        choice(name, known, "name", " or ".join(map(repr, known)))
        joint_names = joints_named(joint_names)
        bounds = self._bounds_of(name, joint_names)
        return np.array([bounds.get(joint, np.inf) for joint in joint_names])

    def over(
        self, others: MotionLimits | None, joint_names: Sequence[str]
    ) -> MotionLimits:
        """Complete these limits by others, of lower priority.

        Numbers for all joints, and arrays, set the limit of every joint; mappings only
        of the joints in them. An infinite value removes the limit of the other source,
        and stays: over these others again, the result is the same. Of both shares of
        the torque limits the smaller counts.

        Args:
            others: Limits of lower priority; None to complete nothing.
            joint_names: Names of the joints.

        Raises:
            ProblemError: If there are too many or too few values.
            JointNotFound: If a joint is unknown.
        """
        self.check(joint_names)
        if others is None:
            return self
        instance(others, MotionLimits, "others", "MotionLimits or None")
        kind = max(type(self), type(others), key=lambda one: len(one.__mro__))
        values: dict[str, Any] = {}
        for name in kinds_of(kind):
            own, below = getattr(self, name, None), getattr(others, name, None)
            if own is None:
                own = below
            elif isinstance(own, Mapping) and below is not None:
                own = others._bounds_of(name, joint_names) | dict(own)
            values[name] = own
        scale = min(self.effort_scale, others.effort_scale)
        return kind(**values, effort_scale=scale)

    def renamed(self, names: Mapping[str, str], present: Sequence[str]) -> MotionLimits:
        """The same limits for some of the joints, under other names.

        Args:
            names: New names by current ones; joints that are not in it are left out.
            present: Current names of all joints of the limits, in their order.

        Raises:
            ProblemError: If the names are no names, or a new name repeats.
        """
        instance(names, Mapping, "names", "names of joints by their present ones")
        if names:
            joints_named(list(names.values()), "names")
        present = joints_named(present, "present")
        values: dict[str, Any] = {}
        for name in kinds_of(self):
            bounds = self._bounds_of(name, present).items()
            bounded = {names[k]: v for k, v in bounds if k in names and v != np.inf}
            values[name] = bounded or None
        return replace(self, **values)

    def check(self, joint_names: Sequence[str]) -> None:
        """Check the limits against the joints of a robot.

        Raises:
            ProblemError: If there are too many or too few values.
            JointNotFound: If a joint is unknown.
        """
        joint_names = joints_named(joint_names)
        for name in kinds_of(self):
            self._bounds_of(name, joint_names)

    @property
    def continuous(self) -> bool:
        """Whether accelerations must be continuous."""
        return any(kind.smooth for kind in self._bounded)

    @property
    def _bounded(self) -> list[LimitKind]:
        """Kinds of limits that have bounds."""
        kinds = []
        for name, kind in kinds_of(self).items():
            bounds = getattr(self, name)
            each = bounds.values() if isinstance(bounds, Mapping) else np.ravel(bounds)
            if bounds is not None and any(bound != np.inf for bound in each):
                kinds.append(kind)
        return kinds


def classes_of_limits() -> list[type[MotionLimits]]:
    """Classes of motion limits, with those that a caller has defined."""
    return [MotionLimits, *MotionLimits.__subclasses__()]


def joint_kinds() -> dict[str, LimitKind]:
    """All kinds of limits of joints by name, with those that a caller has defined."""
    every = classes_of_limits()
    further = [kind for limits in every for kind in kinds_of(limits).values()]
    known = POSITION, VELOCITY, EFFORT, FEEDBACK, HOLDING, *further
    return {kind.name: kind for kind in known}


def limits_by_joint(
    values: Mapping[str, Mapping[str, float]], joint_names: Sequence[str]
) -> MotionLimits | None:
    """Accelerations, jerks and torque rates of the moving joints; None without any.

    Args:
        values: Values by quantity and joint name, as in files and data sheets.
        joint_names: Joints that move; values of other joints are dropped, and infinite
            values.
    """
    limits: dict[str, Any] = {}
    for name in kinds_of(MotionLimits):
        items = values.get(name, {}).items()
        bounds = {k: v for k, v in items if k in joint_names and v != np.inf}
        if bounds:
            limits[name] = bounds
    return MotionLimits(**limits) if limits else None
