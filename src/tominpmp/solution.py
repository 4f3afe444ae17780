"""Result of planning: a motion, its status, and the history of the iteration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tominpmp.arrays import MaybeNone
from tominpmp.checks import flag, instance
from tominpmp.dynamics import unknown_torques
from tominpmp.exceptions import PlanningFailed, ProblemError, brief, warn_caller
from tominpmp.motion.measures import (
    ENERGIES,
    PeakAcceleration,
    peak_acceleration,
    roughness,
)
from tominpmp.motion.trajectory import Trajectory
from tominpmp.notebook import card, curves, table
from tominpmp.options import Options
from tominpmp.problem.problem import Problem
from tominpmp.problem.segments import SegmentOfMotion, segments_of
from tominpmp.status import IterationRecord, Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tominpmp.bounds.result import LowerBound
    from tominpmp.certificate.certificate import Certificate
    from tominpmp.physics.replay import PhysicsReplay
    from tominpmp.sensitivities.records import Sensitivities
    from tominpmp.verification.clearance import ClearanceProof
    from tominpmp.verification.verification import Verification


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of planning; true if planning succeeded.

    Attributes:
        problem: The problem.
        options: The options of the plan, with the method and the solver of linear
            programs that the planner chose; "auto" may remain as the control and the
            refinement, which are chosen for each start.
        status: How planning ended.
        message: The status with its reason, in a sentence or two.
        feasible: Whether the motion keeps all constraints.
        trajectory: The best motion; None if no motion was found at all.
        initial: The motion from which the iteration started.
        history: One record per iteration.
        planning_time: Time taken [s].
        violations: Largest violation by kind of constraint, in the scaling of the rows.
        verification: Independent replay of the torques, if it was done.
        lower_bound: Lower bound on the duration of any motion, if it was computed.
    """

    problem: Problem
    options: Options
    status: Status
    message: str
    feasible: bool
    trajectory: Trajectory | MaybeNone
    initial: Trajectory | MaybeNone = None
    history: tuple[IterationRecord, ...] = ()
    planning_time: float = 0.0
    violations: dict[str, float] = field(default_factory=dict)
    verification: Verification | MaybeNone = None
    lower_bound: LowerBound | MaybeNone = None

    def __post_init__(self) -> None:
        """Remove the controls of a kinematic robot, accelerations, from the torques."""
        robot = instance(self.problem, Problem, "problem").robot
        for name in ("trajectory", "initial"):
            motion = getattr(self, name)
            if robot.kinematic and isinstance(motion, Trajectory):
                object.__setattr__(self, name, motion.with_torques(unknown_torques))

    @property
    def success(self) -> bool:
        """Whether there is a motion that reaches the goal and keeps all constraints."""
        return self.feasible and self.trajectory is not None

    def __bool__(self) -> bool:
        """Whether planning succeeded."""
        return self.success

    def __repr__(self) -> str:
        """Outcome, duration and method, on one line."""
        robot, options = brief(self.problem.robot.name), self.options
        time = f"T = {self.T:.6g} s" if self.success else "no motion"
        verified = ", verified" if self.verification else ""
        return (
            f"<Solution {self.status.name} for {robot}: {time}, method "
            f"{options.method}{verified}, planned in {self.planning_time:.3g} s>"
        )

    def _repr_html_(self) -> str:
        """Speeds and controls relative to their limits, and the status (notebooks)."""
        from tominpmp.viz.shares import shares_of_limits

        panels = list[str]()
        rows: list[tuple[str, object]] = [("", self.message), ("T [s]", self.T)]
        rows.append(("planned in [s]", self.planning_time))
        if self.success and self.lower_bound is not None:
            rows += [("lower bound", self.lower_bound.in_words(self.T))]
        if self.trajectory is not None:
            times = np.linspace(0.0, self.trajectory.duration, 200)
            shares = shares_of_limits(self.problem, self.trajectory, times)
            for kind, x in (("speed", shares.speed), (shares.control, shares.torque)):
                panels += [curves(f"{kind} over its limit", times, x, (-1.0, 1.0))]
        title = "Solution" if self.success else "No motion"
        return card(title, *panels, table((), rows))

    def __getstate__(self) -> dict[str, Any]:
        """State to copy and pickle: all but the callback, which is no longer needed."""
        state = dict(self.__dict__)
        if self.options.callback is not None:
            state["options"] = replace(self.options, callback=None)
        return state

    @property
    def T(self) -> float:
        """Duration of the motion [s]; infinite if planning failed.

        After a failure the best motion, if any, has a duration of its own:
            ``solution.trajectory.duration``.
        """
        return self.trajectory.duration if self.success else math.inf

    @cached_property
    def energy(self) -> float | None:
        """Energy according to ``options.energy``.

        None if there is no motion, or the robot is kinematic.

        The integral of the squared torques of all motors over time [N^2 m^2 s],
        including the forces of prismatic joints [N], or the mechanical work of all
        motors [J].
        """
        if self.trajectory is None or self.problem.robot.kinematic:
            return None
        return ENERGIES[self.options.energy].of(self.trajectory)

    @property
    def cost(self) -> float:
        """Objective of the plan: T + energy_weight times the energy [s].

        Infinite if planning failed.
        """
        weight = self.options.energy_weight
        if not weight or self.energy is None or not self.success:
            return self.T
        return self.T + weight * self.energy

    @property
    def gap(self) -> float | None:
        """Relative gap between T and the lower bound; None without success or bound.

        A gap above 1 means a bound below half of T: it says little about the motion,
            and messages do not mention it.
        """
        bound = self.lower_bound
        if not self.success or bound is None or not bound.T > 0.0:
            return None
        return self.T / bound.T - 1.0

    @cached_property
    def segments(self) -> tuple[SegmentOfMotion, ...]:
        """The segments of the motion in their order; empty without a motion."""
        if self.trajectory is None:
            return ()
        return segments_of(self.trajectory, self.problem.segments)

    @property
    def roughness(self) -> float:
        """Roughness of the torques; infinite if planning failed, NaN without torques.

        The sum over the joints of the squared torque differences between neighbouring
        ones of 1000 instants, in full ranges of the torque.
        """
        if self.trajectory is None or not self.success:
            return math.inf
        return roughness(self.trajectory, self.problem.robot.limits)

    @cached_property
    def peak_acceleration(self) -> PeakAcceleration | None:
        """Largest acceleration of the motion; of joints without a limit, if any.

        None if there is no motion.
        """
        if self.trajectory is None:
            return None
        return peak_acceleration(self.problem, self.trajectory)

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.history)

    @cached_property
    def certificate(self) -> Certificate | MaybeNone:
        """Certificate of the first-order optimality conditions of the motion.

        It is computed at the first access; None if there is no motion.

        Raises:
            ProblemError: If the motion does not belong to the robot of the problem, or
                dwells while obstacles move.
        """
        from tominpmp.certificate.certificate import with_bound
        from tominpmp.certificate.minimum_principle import certify

        if self.trajectory is None:
            return None
        found = certify(
            self.problem,
            self.trajectory,
            verification=self.verification,
            control_period=self.options.control_period,
        )
        if self.options.energy_weight or self.options.slack:
            given = "less energy" if self.options.energy_weight else "quieter torques"
            note = "This is about the duration alone, some of which the motion gives "
            return replace(found, message=f"{note}away for {given}. {found.message}")
        bound = self.lower_bound
        if bound is None or not self.verification:
            return found
        return with_bound(found, self.T, bound.T, bound.reason)

    @cached_property
    def sensitivities(self) -> Sensitivities:
        """Sensitivity of T to every limit of the problem, which shows the active ones.

        They follow from the multipliers of the certificate, without another plan, at
        the first access; see ``docs/sensitivities.md``.

        Raises:
            ProblemError: If there is no motion or no multiplier of it, its segments
                have times of arrival, or dwells while obstacles move, or energy has a
                weight.
        """
        from tominpmp.sensitivities.analysis import analyse, check_applicable

        check_applicable(self.problem, self.options.energy_weight)
        return analyse(self.problem, self._motion())

    def prove_clearance(self) -> ClearanceProof:
        """Prove that the motion keeps its clearance at all times, not at samples only.

        Each segment is checked among its own obstacles, with its own load.

        Returns:
            The proof, or the failure with its place and the tightest place.

        Raises:
            ProblemError: If there is no motion.
        """
        from tominpmp.verification.clearance import clearance_of

        replay = self.verification
        deviation = None if replay is None else replay.deviation
        return clearance_of(self.problem, self._motion(), deviation)

    def raise_if_failed(self) -> Solution:
        """Return the solution itself, or raise an error if planning failed.

        Raises:
            PlanningFailed: If there is no motion that keeps all constraints.
        """
        if not self.success:
            raise PlanningFailed(self)
        return self

    def _step_of_rows(self, dt: float | None) -> float | None:
        """Time between the rows of a file [s]: dt, or the control period of the plan.

        None, if there is neither, stands for the nodes of the motion.
        """
        return self.options.control_period if dt is None else dt

    def _motion(self) -> Trajectory:
        if self.trajectory is None:
            raise ProblemError(f"there is no motion: {self.message}", "trajectory")
        return self.trajectory

    def play(self, path: str | Path | None = None, **options: Any) -> Any:
        """Show the motion in Meshcat; see :func:`tominpmp.viz.playback.play`.

        Args:
            path: Where to write a page that works offline; None opens a browser.
            **options: Further arguments of that function.

        Raises:
            ProblemError: If there is no motion.
            MissingDependency: If Meshcat is not installed.
        """
        from tominpmp.viz.playback import play

        return play(self.problem, self._motion(), path=path, **options)

    def plot(
        self,
        path: str | Path | None = None,
        *,
        ax: Axes | Sequence[Axes] | None = None,
    ) -> Figure:
        """Plot positions, velocities and torques over time with their limits.

        Args:
            path: File to write (PNG, PDF or SVG by its ending), if any.
            ax: Axes of matplotlib to draw on, instead of a new figure: one axes object
                for the torques relative to their limits, or three for positions,
                velocities and torques of all joints.

        Returns:
            The figure.

        Raises:
            ProblemError: If there is no motion, the ending is unknown, or the axes are
                neither one nor three of matplotlib.
            ScenarioError: If the file cannot be written.
            MissingDependency: If matplotlib is not installed.
        """
        from tominpmp.viz.plots import plot_on_axes, plot_trajectory

        if ax is not None:
            return plot_on_axes(self.problem, self._motion(), ax, path=path)
        return plot_trajectory(self.problem, self._motion(), path=path)

    def plot_certificate(self, path: str | Path | None = None) -> Figure:
        """Plot torques, switching functions, active limits and the Hamiltonian.

        Args:
            path: File to write (PNG, PDF or SVG by its ending), if any.

        Returns:
            The figure.

        Raises:
            ProblemError: If there is no motion or no certificate of it, or the ending
                is unknown.
            ScenarioError: If the file cannot be written.
            MissingDependency: If matplotlib is not installed.
        """
        from tominpmp.viz.plots import plot_certificate

        motion = self._motion()
        return plot_certificate(self.problem, motion, self.certificate, path=path)

    def replay(self, engine: str = "mujoco", **options: Any) -> PhysicsReplay:
        """Replay the motion in a simulator that shares no code with the planner.

        See :func:`tominpmp.physics.replay.replay`.

        Raises:
            ProblemError: If there is no motion, or the engine is unknown.
            MissingDependency: If the engine is not installed.
        """
        # An add-on is imported by name, so that the core works without it.
        physics = import_module("tominpmp.physics.replay")
        replayed: PhysicsReplay = physics.replay(
            self.problem, self._motion(), engine=engine, **options
        )
        return replayed

    def export(
        self,
        path: str | Path,
        *,
        dt: float | None = None,
        with_effort: bool = False,
        message: str | None = None,
        verify: bool = True,
    ) -> Path:
        """Write the motion as CSV, NPZ or ROS message, by the ending of the path.

        The file is read back and verified with the interpolation that its reader will
        use; if that motion does not solve the problem, a warning says so. The full
        result of this check comes from
        :func:`~tominpmp.files.export_check.check_export`.

        Args:
            path: File to write.
            dt: Time between rows [s]; None takes the control period of the plan, or the
                nodes if there is no period.
            with_effort: Whether ROS messages contain the torques.
            message: Type of the ROS message, see :func:`~tominpmp.files.export.export`.
            verify: Whether to verify the file.

        Returns:
            The path.

        Raises:
            ProblemError: If there is no motion, the ending is unknown or an option is
                wrong.
            ScenarioError: If the file cannot be written.
            MissingDependency: If a package for bags is not installed.
        """
        from tominpmp.files.export import export
        from tominpmp.files.export_check import check_export

        flag(verify, "verify")
        dt, motion = self._step_of_rows(dt), self._motion()
        path = export(motion, path, dt=dt, with_effort=with_effort, message=message)
        if verify and self.success:
            check = check_export(self, path, dt=dt)
            if not check.ok:
                warn_caller(check.message)
        return path
