"""How much torque reserve keeps a motion on its way when the world is not as modelled.

A motion in minimum time uses all of some torque most of the time, so that a feedback
can correct one way only. Planned with a share of the torques (``effort_scale``), it
takes longer and leaves room. Here random loads, friction, delays and noise are tried
in MuJoCo for several reserves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, TypeAlias

import numpy as np
import pinocchio as pin

from tominpmp.arrays import Array, FrozenArray, Record, array_or_nan
from tominpmp.checks import instance, number, positive, whole, wrong
from tominpmp.exceptions import naming
from tominpmp.motion.trajectory import Trajectory
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options
from tominpmp.physics.mujoco_arm import MujocoArm
from tominpmp.physics.replay import check_one_load, follow
from tominpmp.problem.problem import Problem

RESERVES = (0.0, 0.05, 0.1, 0.2, 0.3)
# Share of the trials that are to keep the tolerance.
WANTED = 0.99
MOST_SAMPLES = 100_000


Amount: TypeAlias = Annotated[
    float, partial(number, expected="a finite number >= 0", least=0.0)
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Disturbances(Record):
    """Largest disturbances of the random trials.

    Attributes:
        payload: Largest mass that is carried beside what is modelled [kg].
        friction: Largest dry friction beside what is modelled, as a share of the torque
            limit of each joint.
        delay: Longest time from a measurement to the torque that follows from it [s].
        noise: Standard deviation of measured positions [rad or m]; velocities are
            measured with ten times that per second.
    """

    payload: Amount = 0.2
    friction: Amount = 0.01
    delay: Amount = 0.002
    noise: Amount = 1e-5

    def __post_init__(self) -> None:
        """Check the numbers."""
        with naming("disturbances"):
            super().__post_init__()

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
    """What torque reserves bring, and cost.

    Attributes:
        reserves: Shares of the torque limits that plans leave unused, shape (k,).
        T: Durations of the plans [s], shape (k,); infinite where none was found.
        kept: Shares of the trials that stayed within the tolerance, shape (k,).
        errors: Distances from the motion that 99 % of the trials kept below, shape (k,)
            [rad or m].
        tolerance: Largest distance of a joint from the motion that is tolerated.
        samples: Number of trials for each reserve.
        disturbances: What was drawn at random for each trial.
        effort_scale: Share of the torque limits that the problem itself lets motions
            use; the reserves are shares of that.
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
        """Least of the reserves that keeps 99 % within the tolerance; None if none."""
        good = np.flatnonzero((self.kept >= WANTED) & np.isfinite(self.T))
        return float(self.reserves[good[0]]) if good.size else None

    @property
    def cost(self) -> float | None:
        """What it costs: a share of the duration with the least one of a motion."""
        if self.reserve is None:
            return None
        T = self.T[self.reserves == self.reserve][0]
        return float(T / self.T[np.isfinite(self.T)][0] - 1.0)

    @property
    def message(self) -> str:
        """What was found, in a sentence."""
        if self.reserve is None:
            best = int(np.argmax(self.kept))
            return (
                f"no reserve keeps {WANTED:.0%} of {self.samples} trials within "
                f"{self.tolerance:g} rad or m; {self.reserves[best]:.0%} keeps "
                f"{self.kept[best]:.0%}"
            )
        own, scale = self.effort_scale, self.effort_scale * (1.0 - self.reserve)
        of = f" of the {own:.0%} that motions may use" if own < 1.0 else ""
        return (
            f"a torque reserve of {self.reserve:.0%}{of} (effort_scale={scale:g}) "
            f"keeps {WANTED:.0%} of {self.samples} trials "
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
    """Plan with several torque reserves, and try each motion in a world that is off.

    A feedback of position and velocity with the plan's torques as feed-forward follows
    the motion; torques beyond the limits are cut off.

    Args:
        problem: The problem.
        options: How to plan.
        disturbances: What is drawn at random; the defaults are those of an arm that is
            known well.
        reserves: Shares to leave unused, from 0 to below 1, of the torques that the
            problem lets motions use: of its torque limits times its ``effort_scale``,
            segment by segment.
        samples: Number of trials for each.
        tolerance: Largest distance of a joint from the motion [rad or m].
        bandwidth: How fast the feedback brings errors to zero [1/s].
        period: Period of the controller, and step of the simulator [s].
        frame: Frame that carries the load; None for that of the goal, or the last one.
        seed: Of the random numbers; the trials are the same for each reserve.

    Raises:
        ProblemError: If a value is wrong.
        FrameNotFound: If there is no such frame.
        MissingDependency: If MuJoCo is not installed.
    """
    from tominpmp.planner.planning import plan

    shares = _checked_reserves(reserves)
    tolerance = positive(tolerance, "tolerance", "rad or m")
    bandwidth, period = positive(bandwidth, "bandwidth"), positive(period, "period")
    world = Disturbances() if disturbances is None else disturbances
    instance(problem, Problem, "problem")
    check_one_load(problem)
    instance(world, Disturbances, "disturbances", "Disturbances or None")
    whole(samples, "samples", 1, MOST_SAMPLES)
    whole(seed, "seed")
    arm = MujocoArm(problem.robot)  # a missing package is reported before planning
    carrier = _carrier(problem, frame)
    T, kept, errors = [], [], []
    for reserve in shares.tolist():
        solution = plan(_with_reserve(problem, reserve), options)
        found = np.full(samples, np.inf)
        if solution.success:
            rng, motion = np.random.default_rng(seed), solution.trajectory
            how = carrier, arm.gains(motion.q, bandwidth), period, world, rng
            found = np.array([_error(problem, motion, *how) for _ in range(samples)])
        T.append(solution.T)
        kept.append(float(np.mean(found <= tolerance)))
        errors.append(float(np.quantile(found, WANTED, method="higher")))
    return Robustness(
        reserves=shares,
        T=np.array(T),
        kept=np.array(kept),
        errors=np.array(errors),
        tolerance=float(tolerance),
        samples=samples,
        disturbances=world,
        effort_scale=(problem.motion_limits or MotionLimits()).effort_scale,
    )


def _checked_reserves(reserves: object) -> Array:
    shares = array_or_nan(reserves)
    good = shares.ndim == 1 and shares.size and np.all((shares >= 0.0) & (shares < 1.0))
    if not good:
        raise wrong(reserves, "reserves", "shares from 0 to below 1")
    return np.unique(shares)


def _with_reserve(problem: Problem, reserve: float) -> Problem:
    """The problem with a share of the torques that it leaves to motions.

    Those of segments are shares, too, of which the smaller one counts: each is taken.
    """
    if reserve == 0.0:
        return problem

    def reduced(limits: MotionLimits | None) -> MotionLimits:
        known = limits or MotionLimits()
        return replace(known, effort_scale=(1.0 - reserve) * known.effort_scale)

    changes: dict[str, Any] = {"motion_limits": reduced(problem.motion_limits)}
    if problem.segments:
        changes["goal"] = None  # that of the last segment
        changes["segments"] = tuple(
            replace(item, motion_limits=reduced(item.motion_limits))
            for item in problem.segments
        )
    return replace(problem, **changes)


def _carrier(problem: Problem, frame: str | None) -> tuple[int, Array]:
    """Joint that moves the frame with the load, and where that is on it."""
    robot = problem.robot
    name = problem.goal.frame_name if frame is None else frame
    index = robot.model.nframes - 1 if name is None else robot.frame_id(name)
    found: pin.Frame = robot.model.frames[index]
    joint = int(found.parentJoint) or robot.model.njoints - 1
    return joint, np.array(found.placement.translation)


def _error(
    problem: Problem,
    trajectory: Trajectory,
    carrier: tuple[int, Array],
    gains: tuple[Array, Array],
    period: float,
    world: Disturbances,
    rng: np.random.Generator,
) -> float:
    """Largest distance of a joint from a motion that is followed in one trial."""
    limits, n = problem.robot.limits, problem.robot.n
    most = limits.effort_lower, limits.effort_upper
    arm = MujocoArm(problem.robot)
    arm.load(rng.uniform(0.0, world.payload), *carrier)
    arm.add_friction(
        rng.uniform(0.0, world.friction, n) * np.maximum(-most[0], most[1])
    )
    late = round(rng.uniform(0.0, world.delay) / period)
    count = max(int(np.ceil(trajectory.duration / period)), 1)
    times = np.linspace(0.0, trajectory.duration, count + 1)
    arm.choose_integrator(float(times[1]), trajectory.q[0])
    noise = rng.normal(0.0, 1.0, (2, times.size, n)) * world.noise
    noise[1] *= 10.0
    q = follow(arm, trajectory, times, gains, most=most, late=late, noise=noise)[0]
    return float(np.abs(q - trajectory(times).q).max())
