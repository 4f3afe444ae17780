"""Limits beyond those of a description file, as controllers and motors have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, Record, array_or_nan, record
from tominpmp.checks import (
    array,
    choice,
    instance,
    number,
    positive,
    vector,
    whole,
    wrong,
)
from tominpmp.checks import names as joints_named
from tominpmp.exceptions import JointNotFound, ProblemError, told_of

PerJoint: TypeAlias = "float | ArrayLike | Mapping[str, float] | None"

UNITS = {
    "acceleration": "rad/s^2 or m/s^2",
    "jerk": "rad/s^3 or m/s^3",
    "effort_rate": "N m/s or N/s",
}


Row: TypeAlias = Annotated[
    Converted[ArrayLike, Array], partial(vector, expected="a row of numbers")
]


@record
class EffortCurve(Record):
    """Largest torque of a motor over its speed, joined by straight lines.

    Attributes:
        speed: Absolute speeds, from 0, increasing, shape (k,) [rad/s or m/s].
        effort: Largest torque there, shape (k,) [N m or N]. Beyond the last speed it
            stays as it is there.
    """

    speed: Row
    effort: Row

    def __post_init__(self) -> None:
        """Check the curve."""
        with told_of("effort curve"):
            super().__post_init__()
        if self.speed.size != self.effort.size or self.speed.size < 2:
            raise ProblemError(
                f"effort curve: {self.speed.size} speeds and {self.effort.size} "
                "torques, expected as many of each, two at least",
                "effort",
            )
        if self.speed[0] != 0.0 or np.any(np.diff(self.speed) <= 0.0):
            raise ProblemError(
                f"effort curve: speeds are {self.speed.tolist()}, expected to increase "
                "from 0",
                "speed",
            )
        if np.any(self.effort < 0.0):
            raise ProblemError(
                f"effort curve: torques are {self.effort.tolist()}, expected none "
                "below 0",
                "effort",
            )

    @classmethod
    def droop(cls, stall: float, no_load_speed: float) -> EffortCurve:
        """Linear droop of a direct-current motor: no torque at the no-load speed."""
        top = positive(no_load_speed, "no_load_speed", "rad/s or m/s")
        torque = number(stall, "stall", "a number >= 0 [N m or N]", least=0.0)
        return cls(np.array([0.0, top]), np.array([torque, 0.0]))

    @classmethod
    def power(
        cls, effort: float, power: float, top_speed: float, points: int = 12
    ) -> EffortCurve:
        """Constant torque up to a power limit [W], chords of the hyperbola beyond."""
        effort = positive(effort, "effort", "N m or N")
        knee = positive(power, "power", "W") / effort
        top_speed = positive(top_speed, "top_speed", "rad/s or m/s")
        count = whole(points, "points", least=2)
        speed = np.concatenate([[0.0], np.geomspace(knee, max(top_speed, knee), count)])
        if top_speed <= knee:
            return cls(np.array([0.0, knee]), np.array([effort, effort]))
        # Tangents would be on the safe side everywhere; chords pass it by < 1 %.
        return cls(speed, np.minimum(effort, power / np.maximum(speed, knee)))

    def __call__(self, speed: Array) -> tuple[Array, Array]:
        """Largest torque and its slope over |speed|, of any shape."""
        magnitude = np.abs(array(speed, "speed", (...,), "speeds"))
        value = np.interp(magnitude, self.speed, self.effort)
        slopes = np.append(np.diff(self.effort) / np.diff(self.speed), 0.0)
        piece = np.searchsorted(self.speed, magnitude, side="right") - 1
        return value, slopes[np.minimum(piece, slopes.size - 1)]


@dataclass(frozen=True, eq=False)
class MotionLimits(Record):
    """Limits beyond those of a description file.

    Values per joint are one number for all, an array in joint order, or a mapping of
    joint names for some; None or infinity is no limit.

    Attributes:
        acceleration: Largest acceleration [rad/s^2 or m/s^2].
        jerk: Largest jerk [rad/s^3 or m/s^3].
        effort_rate: Largest torque rate [N m/s or N/s] (paper, section 4).
        effort_scale: Share of the torque limits that the motion may use; the rest is
            left for the feedback controller.
        effort_curves: Torque over speed by joint name.
    """

    acceleration: PerJoint = None
    jerk: PerJoint = None
    effort_rate: PerJoint = None
    effort_scale: float = 1.0
    effort_curves: Mapping[str, EffortCurve] | None = None

    def __post_init__(self) -> None:
        """Check what can be told without a robot."""
        expected = "a share in (0, 1]"
        scale = number(self.effort_scale, "effort_scale", expected, above=0.0, most=1.0)
        object.__setattr__(self, "effort_scale", scale)
        given = {} if self.effort_curves is None else self.effort_curves
        instance(given, Mapping, "effort_curves", "EffortCurves by joint name")
        curves = dict(given)
        for joint, curve in curves.items():
            if not isinstance(curve, EffortCurve):
                raise ProblemError(
                    f"effort_curves: joint {joint!r} has a {type(curve).__name__}, "
                    "expected an EffortCurve",
                    "effort_curves",
                )
        object.__setattr__(self, "effort_curves", curves)
        for name in UNITS:
            value = getattr(self, name)
            if value is None or isinstance(value, Mapping):
                continue
            object.__setattr__(self, name, self._numbers(name, value))

    @staticmethod
    def _numbers(name: str, value: object, most: int = 1) -> Array:
        """Positive numbers, with so many axes at most."""
        array = array_or_nan(value)
        if array.ndim > most or np.any(np.isnan(array)) or np.any(array <= 0.0):
            raise wrong(value, name, f"positive numbers [{UNITS[name]}]")
        return array

    def _values(self) -> tuple[object, ...]:
        def plain(value: object) -> object:
            if isinstance(value, Mapping):
                return tuple(sorted(value.items(), key=lambda item: str(item[0])))
            return (
                tuple(np.ravel(value).tolist())
                if isinstance(value, np.ndarray)
                else value
            )

        curves = tuple(
            (joint, tuple(curve.speed.tolist()), tuple(curve.effort.tolist()))
            for joint, curve in sorted((self.effort_curves or {}).items())
        )
        rest = tuple(plain(getattr(self, name)) for name in UNITS)
        return (*rest, self.effort_scale, curves)

    def by_joint(self, name: str, joint_names: Sequence[str]) -> Array:
        """Values of a limit for the joints of a robot, infinite for none, shape (n,).

        Args:
            name: "acceleration", "jerk" or "effort_rate".
            joint_names: Names of the joints.

        Raises:
            ProblemError: If there are too many or too few values.
            JointNotFound: If a joint is unknown.
        """
        choice(name, tuple(UNITS), "name", " or ".join(map(repr, UNITS)))
        joint_names = joints_named(joint_names)
        value, n = getattr(self, name), len(joint_names)
        if value is None:
            return np.full(n, np.inf)
        if isinstance(value, Mapping):
            out = np.full(n, np.inf)
            for joint, limit in value.items():
                if joint not in joint_names:
                    raise JointNotFound(joint, joint_names)
                out[joint_names.index(joint)] = self._numbers(name, limit, most=0)
            return out
        if value.ndim == 1 and value.size != n:
            raise ProblemError(
                f"{name} has {value.size} numbers, expected {n}, one for each of: "
                f"{', '.join(joint_names)}",
                name,
            )
        return np.asarray(np.broadcast_to(value, (n,)).copy())

    def over(
        self, others: MotionLimits | None, joint_names: Sequence[str]
    ) -> MotionLimits:
        """These limits, and where they say nothing those of another source.

        Numbers for all joints, and arrays, say something of every joint; mappings only
        of the joints in them. An infinite one says that there is no limit.

        Args:
            others: The other limits, which these go before; None for none.
            joint_names: Names of the joints.

        Raises:
            ProblemError: If there are too many or too few values.
            JointNotFound: If a joint is unknown.
        """
        if others is None:
            return self
        instance(others, MotionLimits, "others", "MotionLimits or None")
        joint_names = joints_named(joint_names)
        values: dict[str, PerJoint] = {}
        for name in UNITS:
            own, below = getattr(self, name), getattr(others, name)
            if own is None or (isinstance(own, Mapping) and below is None):
                values[name] = below if own is None else own
                continue
            if isinstance(own, Mapping):
                rest = others.by_joint(name, joint_names).tolist()
                merged = {**dict(zip(joint_names, rest, strict=True)), **own}
                own = {k: v for k, v in merged.items() if v != np.inf}
            unlimited = not own if isinstance(own, dict) else np.all(np.isinf(own))
            values[name] = None if unlimited else own
        return MotionLimits(
            **values,
            effort_scale=min(self.effort_scale, others.effort_scale),
            effort_curves={
                **(others.effort_curves or {}),
                **(self.effort_curves or {}),
            },
        )

    def renamed(self, names: Mapping[str, str], present: Sequence[str]) -> MotionLimits:
        """The same limits for some of the joints, under other names.

        Args:
            names: New names by present ones; joints that are not in it are left out.
            present: Names of all joints the limits are for, in their order.
        """
        instance(names, Mapping, "names", "names of joints by their present ones")
        present = joints_named(present, "present")
        values: dict[str, PerJoint] = {}
        for name in UNITS:
            if getattr(self, name) is None:
                continue
            limits = self.by_joint(name, present).tolist()
            rows = dict(zip(present, limits, strict=True))
            kept = {names[k]: v for k, v in rows.items() if k in names and v < np.inf}
            if kept:
                values[name] = kept
        curves = {
            names[k]: v for k, v in (self.effort_curves or {}).items() if k in names
        }
        return MotionLimits(
            **values, effort_scale=self.effort_scale, effort_curves=curves
        )

    def check(self, joint_names: Sequence[str]) -> None:
        """Check the limits against the joints of a robot.

        Raises:
            ProblemError: If there are too many or too few values.
            JointNotFound: If a joint is unknown.
        """
        joint_names = joints_named(joint_names)
        for name in UNITS:
            self.by_joint(name, joint_names)
        for joint in self.effort_curves or {}:
            if joint not in joint_names:
                raise JointNotFound(joint, joint_names)

    @property
    def continuous(self) -> bool:
        """Whether accelerations must not jump."""
        return self.jerk is not None or self.effort_rate is not None

    @property
    def need_smooth(self) -> bool:
        """Whether there is more than a share of the torque limits."""
        return (
            self.continuous or self.acceleration is not None or bool(self.effort_curves)
        )


def limits_by_joint(
    values: Mapping[str, Mapping[str, float]], joint_names: Sequence[str]
) -> MotionLimits | None:
    """Accelerations, jerks and torque rates of joints that move; None without any.

    Args:
        values: By quantity and joint name, as files and data sheets have them.
        joint_names: Joints that move; values of others are left out.
    """
    found: dict[str, PerJoint] = {}
    for quantity in UNITS:
        own = {k: v for k, v in values.get(quantity, {}).items() if k in joint_names}
        if own:
            found[quantity] = own
    return MotionLimits(**found) if found else None  # type: ignore[arg-type]
