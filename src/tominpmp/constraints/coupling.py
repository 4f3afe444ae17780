"""Coupled joints: a weighted sum of joint positions stays within bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tominpmp.arrays import Array, Converted, number_or_nan, record
from tominpmp.checks import JOINTS, array, instance, known_joints, names, vector, whole
from tominpmp.constraints.path import EMPTY, Linear, PathConstraint
from tominpmp.exceptions import ProblemError, brief
from tominpmp.robot.robot import Robot

# Scale of the excess over a bound [rad or m].
SCALE = 0.1


@record
class JointCoupling(PathConstraint):
    """A weighted sum of joint positions stays within bounds, at all times.

    lower <= c^T q <= upper: a parallel mechanism that keeps a tool upright (equal
    bounds), a cable between two joints, a belt.

    Attributes:
        joints: Names of the joints, each of them once.
        weights: Weight c of each joint, shape (k,).
        upper: Upper bound [rad or m]; infinity for no bound.
        lower: Lower bound [rad or m]; minus infinity for no bound.

    Raises:
        ProblemError: If the numbers of weights and joints differ, a joint is named
            twice, or the bounds are in the wrong order or both infinite.
    """

    joints: tuple[str, ...]
    weights: Converted[ArrayLike, Array]
    upper: float
    lower: float = -np.inf

    unit = "rad or m"
    largest = 0.0
    scale = SCALE

    def __post_init__(self) -> None:
        """Check and copy the values."""
        super().__post_init__()
        joints = (self.joints,) if isinstance(self.joints, str) else self.joints
        self._keep(joints=names(joints, f"{self._owner}joints"))
        count = len(self.joints)
        given = [self.weights] if np.isscalar(self.weights) else self.weights
        expected = f"{count} number{'' if count == 1 else 's'}, one for each joint"
        self._keep(weights=vector(given, f"{self._owner}weights", expected, count))
        lower, upper = number_or_nan(self.lower), number_or_nan(self.upper)
        bounded = np.any(np.isfinite([lower, upper]))
        if not lower <= upper or not bounded:
            raise ProblemError(
                f"lower is {brief(self.lower)} and upper {brief(self.upper)}, expected "
                "the lower bound below the upper one, or equal bounds; only one may be "
                "infinite",
                "lower" if bounded else "upper",
            )
        self._keep(lower=lower, upper=upper)

    @property
    def name(self) -> str:
        """Name of the constraint, with its joints."""
        return f"coupling of {self.subject}"

    @property
    def subject(self) -> str:
        """The joints."""
        return f"joints {', '.join(self.joints)}"

    def validate(self, robot: Robot) -> None:
        """Check that the robot has the joints."""
        known_joints(self.joints, instance(robot, Robot, "robot").joint_names, "joints")

    def _sums(self, q: Array) -> Array:
        """Weighted sums of positions, shape (m, n) to (m,)."""
        row = self._row()
        return np.asarray(array(q, "q", (None, row.size), JOINTS) @ row)

    def _row(self) -> Array:
        """Weights of all joints of the robot, shape (n,)."""
        weights = dict(zip(self.joints, self.weights.tolist(), strict=True))
        known = self.kinematics.robot.joint_names
        return np.array([weights.get(joint, 0.0) for joint in known])

    def bounds(self, instants: int) -> tuple[Array, Array]:
        """The bounds, divided by the scale."""
        shape = whole(instants, "instants"), 1
        lower, upper = self.lower / self.scale, self.upper / self.scale
        return np.full(shape, lower), np.full(shape, upper)

    def measure_rows(self, q: Array, v: Array, a: Array) -> Array:
        """Excess of the sums over their bounds, zero within the bounds."""
        total = self._sums(q)
        return np.maximum(np.maximum(self.lower - total, total - self.upper), 0.0)

    def value_rows(self, q: Array, v: Array, a: Array) -> Array:
        """The sums, divided by the scale."""
        return self._sums(q)[:, None] / self.scale

    def term_rows(self, q: Array, v: Array, a: Array) -> Linear:
        """The sums, divided by the scale, with their derivatives."""
        values, row = self.value_rows(q, v, a), self._row() / self.scale
        return values, np.broadcast_to(row, (len(values), 1, row.size)), EMPTY, EMPTY
