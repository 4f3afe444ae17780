"""Torque reserves that let a feedback controller track a motion despite model errors.

A motion in minimum time has a saturated torque most of the time, so that feedback can
correct in one direction only. A motion planned with a share of the torque limits
(``effort_scale``) takes longer and leaves a reserve. Here random loads, friction,
delays and noise are simulated in MuJoCo for several reserves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, FrozenArray, Record, array_or_nan
from tominpmp.checks import Amount, instance, positive, whole, wrong
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.physics.mujoco_arm import MujocoArm
from tominpmp.physics.replay import check_one_load, follow
from tominpmp.problem.problem import Problem
from tominpmp.status import Status

RESERVES = (0.0, 0.05, 0.1, 0.2, 0.3)
# Required share of the trials within the tolerance.
REQUIRED = 0.99
MOST_SAMPLES = 100_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbances(Record):
    """Largest disturbances of the random trials.

    Attributes:
        payload: Largest mass in addition to the modelled load [kg].
        friction: Largest dry friction in addition to the modelled friction, as a share
            of the torque limit of each joint.
        delay: Longest time from a measurement to the torque that follows from it [s].
        noise: Standard deviation of measured positions [rad or m]; the standard
            deviation of measured velocities is ten times that number [rad/s or m/s].
    """

    payload: Amount = 0.2
    friction: Amount = 0.01
    delay: Amount = 0.002
    noise: Amount = 1e-5

    _owner = "disturbances."

    @property
    def message(self) -> str:
        """The disturbances in words."""
        return (
            f"up to {self.payload:g} kg more, dry friction up to {self.friction:.2g} "
            f"of the torque limits, delays up to {self.delay:g} s, noise of "
            f"{self.noise:g} rad or m"
        )


@dataclass(frozen=True, eq=False)
class Robustness(Record):
    """Tracking errors and durations for several torque reserves.

    Attributes:
        reserves: Shares of the torque limits that plans leave unused, shape (k,).
        T: Durations of the plans [s], shape (k,); infinite where no motion was found.
        kept: Shares of the trials that stayed within the tolerance, shape (k,).
        errors: Quantiles of 99 % of the largest distances of the trials from the
            motion, shape (k,) [rad or m].
        tolerance: Largest tolerated distance of a joint from the motion [rad or m].
        samples: Number of trials for each reserve.
        disturbances: Largest random disturbances of a trial.
        effort_scale: Share of the torque limits that the problem allows; the reserves
            are shares of it.
    """

    reserves: FrozenArray
    T: FrozenArray
    kept: FrozenArray
    errors: FrozenArray
    tolerance: float
    samples: int
    disturbances: Disturbances = field(default_factory=Disturbances)
    effort_scale: float = 1.0

    @property
    def reserve(self) -> float | None:
        """Least reserve with 99 % of the trials within the tolerance, or None."""
        good = np.flatnonzero((self.kept >= REQUIRED) & np.isfinite(self.T))
        return float(self.reserves[good[0]]) if good.size else None

    @property
    def cost(self) -> float | None:
        """Increase of T by that reserve, over T of the least reserve with a motion."""
        if self.reserve is None:
            return None
        T = self.T[self.reserves == self.reserve][0]
        return float(T / self.T[np.isfinite(self.T)][0] - 1.0)

    @property
    def message(self) -> str:
        """The least sufficient reserve and its cost, in a sentence."""
        if self.reserve is None:
            best = int(np.argmax(self.kept))
            return (
                f"no reserve keeps {REQUIRED:.0%} of {self.samples} trials within "
                f"{self.tolerance:g} rad or m; {self.reserves[best]:.0%} keeps "
                f"{self.kept[best]:.0%}"
            )
        allowed, scale = self.effort_scale, self.effort_scale * (1.0 - self.reserve)
        share = f" of the {allowed:.0%} that motions may use" if allowed < 1.0 else ""
        return (
            f"a torque reserve of {self.reserve:.0%}{share} (effort_scale={scale:g}) "
            f"keeps {REQUIRED:.0%} of {self.samples} trials "
            f"within {self.tolerance:g} rad or m, for {self.cost:.1%} more time"
        )


def robustness(
    problem: Problem,
    options: Options | None = None,
    *,
    disturbances: Disturbances | None = None,
    reserves: Sequence[float] = RESERVES,
    samples: int = 100,
    tolerance: float = 0.02,
    bandwidth: float = 100.0,
    period: float = 1e-3,
    frame: str | None = None,
    seed: int = 0,
) -> Robustness:
    """Plan with several torque reserves, and simulate each motion with disturbances.

    Feedback of position and velocity, with the plan's torques as feed-forward, tracks
    the motion; torques are clipped to the torque limits of the robot.

    Args:
        problem: The problem.
        options: Options of the plans.
        disturbances: Largest random disturbances; the defaults suit an arm with a good
            model.
        reserves: Shares to leave unused, from 0 to below 1, of the torques that the
            problem allows: of its torque limits times its ``effort_scale``, segment by
            segment.
        samples: Number of trials for each reserve.
        tolerance: Largest tolerated distance of a joint from the motion [rad or m].
        bandwidth: Bandwidth of the feedback [1/s].
        period: Period of the controller, and step of the simulator [s].
        frame: Frame that carries the added load; None for the frame of the goal, or the
            last frame.
        seed: Seed of the random numbers; the trials are the same for each reserve.

    Raises:
        ProblemError: If a value is wrong.
        FrameNotFound: If the frame is unknown.
        MissingDependency: If MuJoCo is not installed.
        KeyboardInterrupt: If Ctrl-C or the callback ended a plan.
    """
    from tominpmp.planner.planning import plan

    shares = _checked_reserves(reserves)
    tolerance = positive(tolerance, "tolerance", "rad or m")
    bandwidth, period = positive(bandwidth, "bandwidth"), positive(period, "period")
    largest = Disturbances() if disturbances is None else disturbances
    instance(problem, Problem, "problem")
    check_one_load(problem)
    instance(largest, Disturbances, "disturbances", "Disturbances or None")
    whole(samples, "samples", 1, MOST_SAMPLES)
    whole(seed, "seed")
    arm = MujocoArm(problem.robot)  # a missing package is reported before planning
    carrier, limits, n = _carrier(problem, frame), problem.robot.limits, problem.robot.n
    low, high = limits.effort_lower, limits.effort_upper

    def error(motion: Trajectory, gains: Any, rng: np.random.Generator) -> float:
        """Largest distance of a joint from a motion in one random trial [rad or m]."""
        loaded = MujocoArm(problem.robot)
        loaded.load(rng.uniform(0.0, largest.payload), *carrier)
        friction = rng.uniform(0.0, largest.friction, n) * np.maximum(-low, high)
        loaded.add_friction(friction)
        delay = round(rng.uniform(0.0, largest.delay) / period)
        count = max(int(np.ceil(motion.duration / period)), 1)
        times = np.linspace(0.0, motion.duration, count + 1)
        loaded.choose_integrator(float(times[1]), motion.q[0])
        noise = rng.normal(0.0, 1.0, (2, times.size, n)) * largest.noise
        noise[1] *= 10.0
        q, _, _ = follow(
            loaded, motion, times, gains, cutoff=(low, high), delay=delay, noise=noise
        )
        return float(np.abs(q - motion(times).q).max())

    rows = []
    for reserve in shares.tolist():
        solution = plan(_with_reserve(problem, reserve), options)
        if solution.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        trials = np.full(samples, np.inf)
        if solution.success:
            rng, motion = np.random.default_rng(seed), solution.trajectory
            gains = arm.gains(motion.q, bandwidth)
            trials = np.array([error(motion, gains, rng) for _ in range(samples)])
        worst = np.quantile(trials, REQUIRED, method="higher")
        rows.append((solution.T, np.mean(trials <= tolerance), worst))
    T, kept, errors = np.array(rows).T
    scale = (problem.motion_limits or MotionLimits()).effort_scale
    return Robustness(shares, T, kept, errors, tolerance, samples, largest, scale)


def _checked_reserves(reserves: object) -> Array:
    shares = array_or_nan(reserves)
    good = shares.ndim == 1 and shares.size and np.all((shares >= 0.0) & (shares < 1.0))
    if not good:
        raise wrong(reserves, "reserves", "shares from 0 to below 1")
    return np.unique(shares)


def _with_reserve(problem: Problem, reserve: float) -> Problem:
    """The problem with its allowed torques reduced by a share.

    Problem and segments may both have an ``effort_scale``, of which the smaller counts,
    so that both are reduced.
    """
    if reserve == 0.0:
        return problem

    def reduced(item: Any, **changes: Any) -> Any:
        """A problem or a segment with its allowed torques reduced."""
        limits = item.motion_limits or MotionLimits()
        limits = replace(limits, effort_scale=(1.0 - reserve) * limits.effort_scale)
        return replace(item, motion_limits=limits, **changes)

    segments = tuple(map(reduced, problem.segments))
    goal = None if segments else problem.goal  # the last segment has the goal
    changed: Problem = reduced(problem, goal=goal, segments=segments)
    return changed


def _carrier(problem: Problem, frame: str | None) -> tuple[int, Array]:
    """Joint that moves the frame with the added load, and its position on it [m]."""
    robot = problem.robot
    name = problem.goal.frame_name if frame is None else frame
    index = robot.model.nframes - 1 if name is None else robot.frame_id(name)
    item: pin.Frame = robot.model.frames[index]
    joint = int(item.parentJoint) or robot.model.njoints - 1
    return joint, np.array(item.placement.translation)
