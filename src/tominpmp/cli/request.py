"""What was asked for on the command line, and the problem that it makes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tominpmp.cli.arguments import Pose, Position

if TYPE_CHECKING:
    from tominpmp.arrays import Array
    from tominpmp.goals import Goal
    from tominpmp.options import Options
    from tominpmp.problem import Problem
    from tominpmp.robot import Robot
    from tominpmp.scene import Scene


@dataclass(frozen=True, kw_only=True)
class RobotRequest:
    """A robot, and what is to be different from its description.

    Attributes:
        robot: Name or path.
        package_dirs: Folders in which to look for ``package://``.
        srdf: Semantic description.
        group: Group of the semantic description whose joints move.
        limits: "datasheet" for those of the maker.
        locks: ``JOINT=VALUE`` of joints that are not to move.
        gravity: Three numbers [m/s^2].
        effort: Torque limits [N m or N], as text.
        velocity: Velocity limits [rad/s or m/s], as text.
        damping: Viscous friction [N m s/rad or N s/m], as text.
        armature: Rotor inertia [kg m^2 or kg], as text.
        friction: Dry friction [N m or N], as text.
        joint_limits: MoveIt's file of limits, which those above go before.
    """

    robot: str
    package_dirs: Sequence[Path] = ()
    srdf: Path | None = None
    group: str | None = None
    limits: str | None = None
    locks: Sequence[str] = ()
    gravity: str | None = None
    effort: str | None = None
    velocity: str | None = None
    damping: str | None = None
    armature: str | None = None
    friction: str | None = None
    joint_limits: Path | None = None

    @property
    def is_scenario(self) -> bool:
        """Whether the robot is that of a scenario file."""
        return self.robot.lower().endswith(".toml")

    def load(self, resting: Mapping[str, float] | None = None) -> Robot:
        """Load the robot.

        Args:
            resting: Joints to lock that the command line does not.

        Raises:
            TominpmpError: If anything in it is wrong.
        """
        from tominpmp.cli.values import joint_pair, joint_values, vector
        from tominpmp.exceptions import OptionsError
        from tominpmp.scenario.joint_limits import load_joint_limits, load_limited_robot

        locked: dict[str, float] = {}
        for text in self.locks:
            joint, value = joint_pair(text, "--lock")
            if joint in locked:
                raise OptionsError(f"--lock: joint {joint!r} is named twice", "--lock")
            locked[joint] = value
        changes: dict[str, Any] = {}
        for name in ("effort", "velocity", "damping", "armature", "friction"):
            text = getattr(self, name)
            if text is not None:
                changes[name] = joint_values(text, f"--{name}")
        if self.gravity is not None:
            changes["gravity"] = vector(self.gravity, "--gravity")
        limits = None
        if self.joint_limits is not None:
            limits = load_joint_limits(self.joint_limits)
        return load_limited_robot(
            limits,
            self.robot,
            changes,
            package_dirs=self.package_dirs,
            srdf=self.srdf,
            group=self.group,
            limits=self.limits,
            locked_joints={**(resting or {}), **locked},
        )


@dataclass(frozen=True, kw_only=True)
class MotionRequest:
    """A start, a goal and what is in the way.

    Attributes:
        start: Positions at the start, as text.
        goal: Positions at the end, as text.
        goal_position: Frame and point [m].
        goal_pose: Frame, point [m] and quaternion (x, y, z, w).
        start_velocity: Joint velocities at the start, as text.
        goal_velocity: Velocities at the end, as text: of the joints, or of the frame.
        obstacles: Obstacles, as text.
        scene: MoveIt planning scene with more of them.
        request: MoveIt motion plan request with start and goal.
        margin: Distance to keep from them [m].
        degrees: Whether angles are in degrees.
        former: File with a former motion to begin with.
        motion_limits: File with limits beyond those of the robot.
    """

    start: str | None = None
    goal: str | None = None
    goal_position: Position | None = None
    goal_pose: Pose | None = None
    start_velocity: str | None = None
    goal_velocity: str | None = None
    obstacles: Sequence[str] = ()
    scene: Path | None = None
    request: Path | None = None
    margin: float | None = None
    degrees: bool = False
    former: Path | None = None
    motion_limits: Path | None = None

    def problem(self, robot: Robot) -> Problem:
        """Make the problem.

        Raises:
            TominpmpError: If anything in it is wrong.
        """
        from tominpmp.cli.values import positions, velocities
        from tominpmp.exceptions import ProblemError
        from tominpmp.problem import Problem
        from tominpmp.scenario.motion_limits import load_motion_limits

        if self.start is None:
            raise ProblemError(
                "there is no start: give --start, or a --scene and a --request", "start"
            )
        self._check_goal()
        scene = self.obstacles_around(robot)
        q_start = positions(self.start, "--start", robot, degrees=self.degrees)
        v_start = None
        if self.start_velocity is not None:
            v_start = velocities(
                self.start_velocity, "--start-velocity", robot, degrees=self.degrees
            )
        limits = None
        if self.motion_limits is not None:
            limits = load_motion_limits(self.motion_limits, robot)
        return Problem(
            robot,
            q_start,
            self._goal(robot, q_start),
            motion_limits=limits,
            scene=scene,
            margin=0.0 if self.margin is None else self.margin,
            v_start=v_start,
        )

    def obstacles_around(self, robot: Robot) -> Scene:
        """Make the scene.

        Raises:
            TominpmpError: If anything in it is wrong.
        """
        from tominpmp.cli.values import obstacle
        from tominpmp.scenario.moveit import load_moveit_scene
        from tominpmp.scene import Scene

        found = [obstacle(text) for text in self.obstacles]
        if self.scene is not None:
            found += load_moveit_scene(self.scene, robot)
        return Scene(found)

    def _check_goal(self) -> None:
        """Check that there is one goal."""
        from tominpmp.exceptions import ProblemError

        options = {
            "--goal": self.goal,
            "--goal-position": self.goal_position,
            "--goal-pose": self.goal_pose,
        }
        given = [name for name, value in options.items() if value is not None]
        if not given:
            raise ProblemError(f"there is no goal: give {' or '.join(options)}", "goal")
        if len(given) > 1:
            raise ProblemError(
                f"{' and '.join(given)} are given, expected one of them", "goal"
            )

    def _goal(self, robot: Robot, q_start: Array) -> Goal:
        from tominpmp.cli.values import positions, vector, velocities
        from tominpmp.goals import JointGoal, PoseGoal, PositionGoal

        name = "--goal-velocity"
        if self.goal is not None:
            q = positions(
                self.goal, "--goal", robot, base=q_start, degrees=self.degrees
            )
            v = None
            if self.goal_velocity is not None:
                v = velocities(self.goal_velocity, name, robot, degrees=self.degrees)
            return JointGoal(q, v)
        frame_v: Any = None
        if self.goal_velocity is not None:
            frame_v = vector(self.goal_velocity, name)
        if self.goal_position is not None:
            frame, *point = self.goal_position
            position: Any = point
            return PositionGoal(frame, position, frame_v)
        assert self.goal_pose is not None  # noqa: S101
        frame, *numbers = self.goal_pose
        return PoseGoal(frame, _placement(numbers), frame_v)


def _placement(numbers: Sequence[float]) -> Any:
    """Placement from a point and a quaternion of any length but zero."""
    import numpy as np
    import pinocchio as pin

    from tominpmp.exceptions import ProblemError

    point, quaternion = np.array(numbers[:3]), np.array(numbers[3:])
    length = float(np.linalg.norm(quaternion))
    if not np.all(np.isfinite(numbers)) or length < 1e-9:
        raise ProblemError(
            f"--goal-pose is {' '.join(f'{x:g}' for x in numbers)}, expected finite "
            "numbers X Y Z QX QY QZ QW, the quaternion not zero",
            "goal",
        )
    return pin.SE3(pin.Quaternion(quaternion / length).matrix(), point)


@dataclass(frozen=True, kw_only=True)
class OutputRequest:
    """What to write and what to show.

    Attributes:
        motion: File for the motion, or "-" for standard output; None takes
            a free name.
        write: Whether to write the motion at all.
        dt: Time between its rows [s]; None for the period of the plan, or the nodes.
        with_effort: Whether ROS messages have the torques.
        message: Which ROS message to write.
        plot: File for the plot.
        page: File for the page with the playback.
        certificate: File for the plot of the certificate.
        scenario: File for the problem and the options.
        json: Whether the report is JSON.
        quiet: Whether to show errors and warnings only.
        verbose: Whether to show the log.
    """

    motion: str | None = None
    write: bool = True
    dt: float | None = None
    with_effort: bool = False
    message: str | None = None
    plot: Path | None = None
    page: Path | None = None
    certificate: Path | None = None
    scenario: Path | None = None
    json: bool = False
    quiet: bool = False
    verbose: bool = False


def make_options(given: Mapping[str, Any]) -> Options:
    """Make options of those that were given, the others as the library has them.

    Raises:
        OptionsError: If one has a value that it cannot have.
    """
    from tominpmp.options import Options

    return Options(**{k: v for k, v in given.items() if v is not None})
