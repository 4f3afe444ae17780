"""Duration of a guess under limits of accelerations, jerks, torque rates and loads.

Paths are timed only by limits of speeds and torques. Limits of accelerations, jerks or
torque rates matter the more, the shorter a motion is. If they dominate, programs that
begin with the timed duration are badly scaled: the guess is then scaled to the duration
that these limits allow.
"""

from __future__ import annotations

import numpy as np

from tominpmp.arrays import Array
from tominpmp.exceptions import ProblemError
from tominpmp.kinematics import units_of
from tominpmp.problem.controls import control_bounds, control_kind
from tominpmp.problem.joint_limits import joint_limits
from tominpmp.transcription.problem_functions import ProblemFunctions

# A joint with a larger mean speed is considered to have no effective limits [rad/s or
# m/s].
FASTEST = 2000.0
# Largest time-scaling factor of a guess for held loads and accelerations of tools, and
# bisections for the factor.
SLOWEST, BISECTIONS = 1000.0, 8


def least_duration(system: ProblemFunctions, q: Array) -> float:
    """Estimate of the duration of a path under motion limits, from rest to rest [s].

    The path is given by configurations, shape (m, n). The estimate tends to be too
    short; it is 0 without limits of accelerations, jerks or torque rates.
    """
    span, zero = np.ptp(q, axis=0), np.zeros((1, q.shape[1]))
    load = system.dynamics.inverse(q[:1], zero, span[None])
    load = np.abs(load - system.dynamics.inverse(q[:1], zero, zero))[0]
    change, times = {"a": span, "j": span, "du": load}, [0.0]
    for item in joint_limits(system.problem):
        if item.kind.quantity in change:
            # Distance from rest to rest under a bang-bang derivative of this order.
            order = item.kind.order
            power = 4.0 * 8.0 ** (order - 2) * change[item.kind.quantity] / item.upper
            times.append(float(np.max(power)) ** (1.0 / order))
    return max(times)


def time_scale(system: ProblemFunctions, q: Array, duration: float) -> float:
    """Time-scaling factor of a guess for limits beyond speeds and torques.

    Args:
        system: Functions of the problem.
        q: Configurations of the guess, shape (m, n).
        duration: Duration of the guess under limits of speeds and torques [s].

    Raises:
        ProblemError: If no limit is effective for the motion.
    """
    factor = max(1.0, least_duration(system, q) / duration)
    speed = np.ptp(q, axis=0) / (factor * duration)
    joint = int(np.argmax(speed))
    if speed[joint] > FASTEST:
        robot = system.problem.robot
        unit = units_of(robot)[joint]
        bounds = control_bounds(robot, system.problem.motion_limits)
        effort = max(abs(bound[joint]) for bound in bounds)
        raise ProblemError(
            f"robot: joint {robot.joint_names[joint]!r} would go "
            f"{np.ptp(q[:, joint]):.3g} {unit} in {factor * duration:.1e} s, as its "
            f"limits of velocity ({robot.limits.velocity[joint]:.3g} {unit}/s) and "
            f"{control_kind(robot).name} ({effort:.3g}) hardly limit it: a "
            "time-optimal motion needs limits. Expected those of the arm as velocity= "
            "and effort= of load_robot, limits='datasheet', or an acceleration= of "
            "MotionLimits",
            "robot",
        )
    return factor


def load_time_scale(system: ProblemFunctions, t: Array, q: Array) -> float:
    """Time-scaling factor of a guess for held loads and for accelerations of tools.

    Args:
        system: Functions of the problem.
        t: Times of the guess [s], shape (m,).
        q: Configurations of the guess, shape (m, n).

    Returns:
        The factor; 1 without such constraints, or if slowing down does not remove the
        violation.
    """
    held = [
        item
        for item in system.problem.ready_constraints
        if item.order == 2 and item.curable and item.window is None
    ]
    if not held or np.any(np.diff(t) <= 0.0):
        return 1.0
    v = np.gradient(q, t, axis=0)
    a = np.gradient(v, t, axis=0)

    def feasible(factor: float) -> bool:
        return all(
            np.max(item.value_rows(q, v / factor, a / factor**2)) <= 0.0
            for item in held
        )

    low, high = 1.0, SLOWEST
    if feasible(low) or not feasible(high):
        return 1.0
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return high
