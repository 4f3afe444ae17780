"""Free, locked and following joints, with their limits, friction and rotor inertia."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Record, array_or_nan, frozen_array
from tominpmp.checks import (
    FARTHEST,
    FLAG,
    HUGE,
    JOINTS,
    TINY,
    array,
    by_joint,
    in_order,
    instance,
    known_joints,
    number,
    raised_as,
    vector,
    wrong,
)
from tominpmp.description.model import build_model
from tominpmp.description.tree import LOSSES, JointDescription, Mimic, UrdfDescription
from tominpmp.exceptions import (
    OptionsError,
    ProblemError,
    brief,
    fail_to_load,
    warn_caller,
)


@dataclass(frozen=True)
class Linkage:
    """Dependence of the joints of a description on those that remain free.

    Attributes:
        description: Links and joints.
        locked: Position of every joint that cannot move [rad or m].
        followers: Joints that follow a free joint, with their direct relation to it.
    """

    description: UrdfDescription
    locked: Mapping[str, float]
    followers: Mapping[str, Mimic]

    @classmethod
    def resolve(
        cls, description: UrdfDescription, locked_joints: Mapping[str, float]
    ) -> Linkage:
        """Express mimic joints by their leaders.

        A leader that is locked, or fixed (which counts as locked at zero), locks its
        followers.

        Args:
            description: Links and joints.
            locked_joints: Positions of the joints to lock [rad or m].

        Raises:
            JointNotFound: If a joint to lock does not exist.
            OptionsError: If a position is not a finite number, is too large, or
                contradicts a leader.
            RobotLoadError: If mimic joints follow each other in a cycle.
        """
        joints = description.joints
        names = [joint.name for joint in joints]
        mimics = {joint.name: joint.mimic for joint in joints if joint.mimic}
        positions = _check_positions(names, locked_joints)
        locked = {k: v for k, v in positions.items() if k not in mimics}
        followers: dict[str, Mimic] = {}
        for name in mimics:
            mimic = _resolve_chain(name, mimics, description.path)
            if mimic.leader in names and mimic.leader not in locked:
                followers[name] = mimic
            else:
                at = locked.get(mimic.leader, 0.0)
                locked[name] = mimic.multiplier * at + mimic.offset
        for name, position in positions.items():
            at, fault = locked.get(name, math.nan), ""
            if name in followers:
                fault = f"follows {followers[name].leader}; lock that one"
            elif not math.isclose(at, position, rel_tol=1e-9, abs_tol=1e-9):
                fault = (
                    f"got {position:g}, but it follows {mimics[name].leader}, which "
                    f"puts it at {at:g}"
                )
            if fault:
                message = f"locked_joints: joint {name} {fault}"
                raise OptionsError(message, "locked_joints")
        return cls(description, locked, followers)

    @cached_property
    def model(self) -> pin.Model:
        """Kinematics and inertia; without limits, and not to be modified."""
        return build_model(self.description, self.locked)

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the n free joints, in the order of all arrays.

        Raises:
            RobotLoadError: If no moving joint remains.
        """
        names = list(self.model.names)[1:]
        leading = {*names} - {*self.followers}
        order = self.description.order or names
        if not leading:
            self.description.fail("no joint is left that moves")
        return tuple(name for name in order if name in leading)

    @cached_property
    def expansion(self) -> tuple[Array, Array]:
        """S, (nv, n), and c, (nv,), of the configuration S q + c of the model."""
        names = list(self.model.names)[1:]
        matrix, offset = np.zeros((len(names), len(self.free))), np.zeros(len(names))
        for row, name in enumerate(names):
            mimic = self.followers.get(name, Mimic(name, 1.0, 0.0))
            matrix[row, self.free.index(mimic.leader)] = mimic.multiplier
            offset[row] = mimic.offset
        return matrix, offset

    def reasons(self) -> dict[str, str]:
        """For every joint that is not free, the reason, in words."""
        follows = {
            name: f"follows {mimic.leader}; set it there"
            for name, mimic in self.followers.items()
        }
        return {name: "is locked" for name in self.locked} | follows

    def warn_of_limits(self) -> None:
        """Warn of joints that are locked outside their limits, beyond rounding."""
        for joint in self.description.joints:
            position = self.locked.get(joint.name)
            # Limits may be missing (NaN) or meaningless for a joint that is not moved.
            if position is None or not joint.lower < joint.upper:
                continue
            if not joint.lower - 1e-9 <= position <= joint.upper + 1e-9:
                unit = "m" if joint.kind == "prismatic" else "rad"
                warn_caller(
                    f"joint {joint.name} is locked at {position:g} {unit}, outside its "
                    f"limits [{joint.lower:g}, {joint.upper:g}]"
                )


def _check_positions(
    names: Sequence[str], locked_joints: Mapping[str, float]
) -> dict[str, float]:
    """Check that positions are numbers and belong to joints."""
    expected = f"a finite number of at most {FARTHEST:g} in size"
    with raised_as(lambda message, _: OptionsError(message, "locked_joints")):
        instance(locked_joints, Mapping, "locked_joints", "positions by joint name")
        known_joints(locked_joints, names, "locked_joints")
        return {
            joint: number(
                at, f"locked_joints: joint {joint}", expected, -FARTHEST, most=FARTHEST
            )
            for joint, at in locked_joints.items()
        }


def _resolve_chain(name: str, mimics: Mapping[str, Mimic], path: Path) -> Mimic:
    """Express a mimic joint by the leader at the end of its chain."""
    multiplier, offset, joint = 1.0, 0.0, name
    for _ in range(len(mimics) + 1):
        if joint not in mimics:
            return Mimic(joint, multiplier, offset)
        mimic = mimics[joint]
        offset += multiplier * mimic.offset
        multiplier *= mimic.multiplier
        joint = mimic.leader
    fail_to_load(path, f"joint {name} follows itself: mimic joints form a cycle")


#: One value for all joints, one per joint in their order, or some by joint name.
JointValues: TypeAlias = ArrayLike | Mapping[str, ArrayLike]


def _fault(option: str, row: Mapping[str, Any]) -> str:
    """Fault of a value for a joint, in a clause; empty for a valid value.

    Args:
        option: Column of the value.
        row: Values of the joint by column.
    """
    value, speed, crossed = row[option], option == "velocity", False
    if option == "effort":
        low, high = value
        value, crossed = max(-low, high), low > high
    elif option.startswith("position"):
        low, high = row["position_lower"], row["position_upper"]
        value, crossed = 0.0, low >= high
    if crossed:
        return (
            f"has the lower limit {low:g} and the upper limit {high:g}, expected the "
            "lower one to be less"
        )
    if value < (TINY if speed else 0.0) or (math.isinf(value) and not speed):
        expected = "a number greater than zero" if speed else "a finite number from 0"
        return f"got {value:g}, expected {expected}"
    return ""


def check_gravity(gravity: ArrayLike) -> Array:
    """Check a caller's gravity [m/s^2], and take it as an array of shape (3,).

    Raises:
        OptionsError: If it is not a vector of three finite numbers.
    """
    with raised_as(OptionsError):
        return vector(gravity, "gravity", "three numbers [m/s^2]", 3)


def check_kinematic(kinematic: object, values: Mapping[str, object]) -> None:
    """Check the flag of kinematic robots, and that they get no dynamic values.

    Args:
        kinematic: Whether the robot is kinematic.
        values: The caller's values by column of the joint table; None for no value.

    Raises:
        OptionsError: If the flag is not a truth value, or a dynamic value is given.
    """
    if not isinstance(kinematic, bool):
        raise wrong(kinematic, "kinematic", FLAG, OptionsError)
    for option in ("effort", *LOSSES):
        if kinematic and values[option] is not None:
            expected = "None for a kinematic robot, which has no torques"
            raise wrong(values[option], option, expected, OptionsError)


def stack_parts(
    joints: Sequence[str], names: Sequence[str], values: Mapping[str, object]
) -> Array:
    """Stack the joint values of several robots into one array, shape (n,).

    The joint names are prefixed with the name of their robot.

    Raises:
        ProblemError: If a robot is missing or unknown, or a length is wrong.
    """
    if not names:
        fault = "the robot was not combined from several: expected combine_robots()"
        raise ProblemError(fault, "robots")
    for name in (*values, *names):
        if name not in names or name not in values:
            state = "given" if name not in names else "missing"
            raise ProblemError(
                f"values for {brief(name)} are {state}; the robots are: "
                f"{', '.join(names)}",
                name,
            )
    rows = []  # the joints of a robot follow each other, in the order of the robots
    for name in names:
        prefix = f"{name}/"
        own = [k.removeprefix(prefix) for k in joints if k.startswith(prefix)]
        named = by_joint(values[name])
        if named is not None:  # by the names within their own robot
            rows.append(in_order(named, own, name))
        else:
            expected = f"{len(own)} numbers, one for each of: {', '.join(own)}"
            rows.append(vector(values[name], name, expected, len(own)))
    return np.concatenate(rows)


@dataclass(frozen=True, eq=False)
class JointLimits(Record):
    """Limits of the n joints of a robot, as read-only arrays of shape (n,).

    Attributes:
        position_lower: Lower position limits [rad or m], possibly infinite.
        position_upper: Upper position limits [rad or m], possibly infinite.
        velocity: Largest speeds in either direction [rad/s or m/s], possibly infinite.
        effort_lower: Lower torque limits [N m or N].
        effort_upper: Upper torque limits [N m or N]; equal to the lower one on a
            passive joint.
    """

    position_lower: Array
    position_upper: Array
    velocity: Array
    effort_lower: Array
    effort_upper: Array

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only."""
        for name, value in vars(self).items():
            row = array(value, name, (None,), JOINTS)
            self._keep(**{name: frozen_array(row)})
        sizes = {name: row.size for name, row in vars(self).items()}
        if len(set(sizes.values())) > 1:
            raise ProblemError(f"limits: lengths differ: {sizes}", "limits")


# Alternative for robots with unknown dynamics, in messages.
KINEMATIC = (
    "kinematic=True to plan with limits of speed and acceleration alone, without "
    "torques"
)

#: Columns of the table: values that callers may override.
OVERRIDES = ("position_lower", "position_upper", "velocity", "effort", *LOSSES)


@dataclass(frozen=True, eq=False)
class JointTable:
    """Values per joint; ``table["velocity"]`` is a column of the table.

    Attributes:
        linkage: The description, with locked and following joints.
        columns: Values of its n free joints by the names in :data:`OVERRIDES`, shape
            (n,), or (n, 2) for the lower and the upper effort limit; unknown values are
            NaN.
    """

    linkage: Linkage
    columns: Mapping[str, Array]

    def __getitem__(self, column: str) -> Array:
        """Values of all joints, shape (n,), or (n, 2) for the effort."""
        return self.columns[column]

    @classmethod
    def from_linkage(cls, linkage: Linkage) -> JointTable:
        r"""Collect the values of the free joints from a description.

        A joint that follows, :math:`q_f = m q + o`, contributes its position and
        velocity limits, its rotor inertia :math:`m^2 a_f` and its friction, viscous
        :math:`m^2 d_f` and dry :math:`|m| f_f`, to the joint that it follows. Its
        effort limit is ignored: the motor is at the leader.

        Args:
            linkage: The description, with locked and following joints.

        Raises:
            RobotLoadError: If no moving joint remains.
        """
        by_name = {joint.name: joint for joint in linkage.description.joints}
        rows = []
        for name in linkage.free:
            joint = by_name[name]
            for follower, mimic in linkage.followers.items():
                if mimic.leader == name:
                    joint = _with_follower(joint, by_name[follower], mimic)
            # In descriptions, a limit of zero stands for an unknown limit.
            velocity = joint.velocity if joint.velocity > 0 else math.nan
            room = joint.effort[1] - joint.effort[0]
            effort = joint.effort if 0 < room < math.inf else np.full(2, math.nan)
            limits = (joint.lower, joint.upper, velocity, effort)
            rows.append((*limits, *(getattr(joint, loss) for loss in LOSSES)))
        columns = (np.array(values, float) for values in zip(*rows, strict=True))
        return cls(linkage, dict(zip(OVERRIDES, columns, strict=True)))

    def overridden(self, values: Mapping[str, JointValues | None]) -> JointTable:
        """Replace values by a caller's values.

        Args:
            values: Values by column of the table; ``None`` changes nothing.

        Raises:
            OptionsError: If a value is wrong.
            JointNotFound: If a joint is unknown.
        """
        changes = {
            option: self._changed(option, value)
            for option, value in values.items()
            if value is not None
        }
        columns = {**self.columns, **changes}
        for option in changes:
            for i, name in enumerate(self.linkage.free):
                if fault := _fault(option, {key: v[i] for key, v in columns.items()}):
                    raise OptionsError(f"{option}: joint {name} {fault}", option)
        return JointTable(self.linkage, columns)

    def _changed(self, option: str, values: Any) -> Array:
        """A column with some of its values replaced by a caller's values.

        Args:
            option: Name of the column, which is that of the argument in messages.
            values: A number for all joints, an array in joint order, or numbers by
                joint name, as mappings and rows of pandas have them; joints that are
                not named keep their value. In a column of lower and upper values, pairs
                are allowed in place of numbers, and a number x means (-x, x).

        Returns:
            The values, of the shape of the column.

        Raises:
            OptionsError: If a value is not a number, or there are too many or too few.
            JointNotFound: If a name is not the name of a joint.
        """
        result, names = np.array(self[option]), self.linkage.free
        not_free = self.linkage.reasons()
        n, pairs = len(names), result.ndim == 2
        values = by_joint(values) or values
        if not isinstance(values, Mapping):
            array = array_or_nan(values)
            fits = array.shape in ((), (n,)) or (pairs and array.shape == (n, 2))
            if not fits or np.isnan(array).all():  # no numbers at all
                forms = f"{n} numbers" + f" or {n} pairs (lower, upper)" * pairs
                raise OptionsError(
                    f"{option}: got {brief(values)}, expected one number, or {forms} "
                    f"in the order {', '.join(names)}, or values by joint name",
                    option,
                )
            rows = array.tolist() if array.ndim else [float(array)] * n
            values = dict(zip(names, rows, strict=True))
        for name, value in values.items():
            if name in not_free:
                raise OptionsError(f"{option}: joint {name} {not_free[name]}", option)
            known_joints([name], names, option)
            array = array_or_nan(value)
            if pairs and array.ndim == 0 and not array < 0:
                array = np.array([-array, array])
            if array.shape != ((2,) if pairs else ()) or np.isnan(array).any():
                form = "a number from 0, or (lower, upper)" if pairs else "a number"
                message = f"{option}: joint {name} got {brief(value)}, expected {form}"
                raise OptionsError(message, option)
            result[names.index(name)] = array
        return result

    def without_dynamics(self) -> JointTable:
        """Table of a kinematic robot: no torque limits, friction or rotor inertia."""
        effort = np.full_like(self["effort"], np.inf) * [-1.0, 1.0]
        losses = {loss: np.zeros_like(self[loss]) for loss in LOSSES}
        return replace(self, columns={**self.columns, **losses, "effort": effort})

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lower and upper position limits, shape (n,) each [rad or m]."""
        return self["position_lower"], self["position_upper"]

    def check_complete(self) -> None:
        """Check that every joint has all limits, a range to move in, and valid losses.

        A warning names joints whose dry friction their motors cannot overcome.

        Raises:
            RobotLoadError: If not; names all such joints, and arguments that help.
        """
        ends, no_effort = np.array(self.ends), np.isnan(self["effort"]).any(axis=1)
        empty = ends[0] >= ends[1]  # not if one of them is NaN
        ranges = ", ".join(f"[{low:g}, {high:g}]" for low, high in ends.T[empty])
        give = "give position_lower={1} and position_upper={1}, or lock them"
        faults = {
            f"no effort limit for {{0}}: give effort={{1}}, or {KINEMATIC}": no_effort,
            "no velocity limit for {0}: give velocity={1}": np.isnan(self["velocity"]),
            f"no position limits for {{0}}: {give}": np.isnan(ends).any(axis=0),
            f"no range between the position limits {ranges} of {{0}}: {give}": empty,
        }
        for loss in LOSSES:
            values = self[loss]
            shown = f"{brief(values.tolist())}, expected numbers from 0 to {HUGE:g}"
            message = f"{loss} is {shown}: give {loss}={{1}}"
            faults[message] = ~((values >= 0.0) & (values <= HUGE))
        complaints = []
        for message, joints in faults.items():
            if names := np.array(self.linkage.free)[joints].tolist():
                values_by_name = example_values(names)
                complaints.append(message.format(", ".join(names), values_by_name))
        if complaints:
            self.linkage.description.fail("; ".join(complaints))
        friction, effort = self["friction"], np.abs(self["effort"]).max(axis=1)
        for i in np.flatnonzero((0.0 < effort) & (effort <= friction)).tolist():
            warn_caller(
                f"the motor of joint {self.linkage.free[i]} cannot move it: its dry "
                f"friction of {friction[i]:g} takes all of its effort limit of "
                f"{effort[i]:g} [N m or N]"
            )


def configured_model(table: JointTable, gravity: Array) -> pin.Model:
    """Model with its limits, friction, rotor inertia and gravity.

    A joint that follows gets the limits that its leader implies, and no motor.

    Args:
        table: Values of the n free joints, without NaN.
        gravity: Gravity in the world, shape (3,) [m/s^2].
    """
    linkage = table.linkage
    model, (matrix, offset) = linkage.model.copy(), linkage.expansion
    leader, ratio = np.abs(matrix).argmax(axis=1), matrix.sum(axis=1)
    is_free = np.isin(list(model.names)[1:], linkage.free)

    def scaled(values: Array) -> Array:
        # An infinite limit times a ratio of zero is zero.
        return np.asarray(np.where(ratio == 0.0, 0.0, values[leader]) * ratio)

    def alone(values: Array) -> Array:
        return np.where(is_free, values[leader], 0.0)

    ends = np.stack([scaled(end) for end in table.ends])
    model.lowerPositionLimit = ends.min(axis=0) + offset
    model.upperPositionLimit = ends.max(axis=0) + offset
    model.velocityLimit = np.abs(scaled(table["velocity"]))
    model.lowerVelocityLimit = -model.velocityLimit
    model.effortLimit = alone(np.abs(table["effort"]).max(axis=1))
    model.lowerEffortLimit = -model.effortLimit
    for loss in LOSSES:
        setattr(model, loss, alone(table[loss]))
    model.gravity = pin.Motion(gravity, np.zeros(3))
    return model


def example_values(joints: Sequence[str]) -> str:
    """Template of an argument with values for some joints, for messages."""
    return "{" + ", ".join(f"{joint!r}: ..." for joint in joints) + "}"


def _with_follower(
    joint: JointDescription, follower: JointDescription, mimic: Mimic
) -> JointDescription:
    """Include limits, friction and rotor of a follower in those of its leader."""
    m = mimic.multiplier
    shares = {"damping": m**2, "armature": m**2, "friction": abs(m)}
    own = {k: getattr(joint, k) + x * getattr(follower, k) for k, x in shares.items()}
    joint = replace(joint, **own)
    if m == 0.0:
        return joint
    if follower.velocity > 0:
        # min() in this order keeps an unknown limit (NaN).
        joint = replace(joint, velocity=min(joint.velocity, follower.velocity / abs(m)))
    # Missing or degenerate limits are common on joints that follow.
    if follower.lower < follower.upper:
        ends = [(x - mimic.offset) / m for x in (follower.lower, follower.upper)]
        lower, upper = max(joint.lower, min(ends)), min(joint.upper, max(ends))
        if joint.lower < joint.upper and not lower < upper:
            warn_caller(
                f"the position limits [{follower.lower:g}, {follower.upper:g}] of "
                f"joint {follower.name} leave joint {joint.name}, which it follows, "
                "no range; they are ignored"
            )
            return joint
        joint = replace(joint, lower=lower, upper=upper)
    return joint
