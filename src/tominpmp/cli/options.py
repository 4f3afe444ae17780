"""The options of the commands: each is declared once, here or by the library.

An option is a field of one of these records; its help text is the entry of the field in
the docstring, with the metavariable in brackets. The options of the planner and the
additional limits of motions are the fields of :class:`~tominpmp.options.Options` and
:class:`~tominpmp.motion_limits.MotionLimits`, see :mod:`~tominpmp.cli.option_fields`.
Only light modules are imported here, as each call of the help imports this module.
"""

from __future__ import annotations

from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from tominpmp.cli.option_fields import GeneralOptions, fields_of, options
from tominpmp.motion.samples import Interpolation
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options

if TYPE_CHECKING:
    PlannerOptions: TypeAlias = Any
    ToleranceOptions: TypeAlias = Any
else:
    PlannerOptions = fields_of(
        Options,
        "Planning",
        {
            "max_planning_time": ({"alias": "--max-time"}, ""),
            # The flag --effort gives torque limits.
            "effort": ({"name": "--planning-effort"}, "Torque limits are --effort."),
        },
    )
    # Tolerances of the replay that judges a motion.
    ToleranceOptions = fields_of(Options, "Planning", ending="_tolerance")


# Headings of options in the help that differ from the heading of their class.
ROBOT, SCENE, MOTION, PLANNING, OUTPUT = (
    {"panel": panel} for panel in ("Robot", "Scene", "Motion", "Planning", "Output")
)
OUTPUT_FILE, QUIET, VERBOSE = ({"alias": alias} for alias in ("-o", "-q", "-v"))

RosMessage = Literal["JointTrajectory", "FollowJointTrajectory", "RobotTrajectory"]


@options("Robot")
class RobotOptions:
    """Options that select a robot or change its description.

    Attributes:
        package_dir (FOLDER): Folder in which to look for package://, repeatable.
        xacro_arg (NAME:=VALUE): Argument of a xacro file, repeatable.
        srdf (FILE): Semantic description, with the group states. Default: the SRDF
            file next to the URDF file.
        group (NAME): Group of the SRDF file whose joints move; the others are held. Or
            the last link of a chain, or, separated by commas, base and last link or the
            joints.
        limits (NAME): datasheet: the limits that the maker publishes, including
            accelerations, the default for a robot given by its name; urdf: the limits
            of its file.
        lock (JOINT=VALUE,...): Hold joints at positions (rad or m), repeatable.
        gravity (X Y Z): Gravity (m/s^2) instead of the robot's.
        effort (VALUES): Torque limits (N m or N) instead of the URDF's: one number for
            all joints; or one for each; or JOINT=VALUE,...
        velocity (VALUES): Velocity limits (rad/s or m/s), in the same form.
        position_lower (VALUES): Lower position limits (rad or m), in the same form.
        position_upper (VALUES): Upper position limits (rad or m), in the same form.
        damping (VALUES): Viscous friction (N m s/rad or N s/m), in the same form.
        armature (VALUES): Rotor inertia at the joint (kg m^2 or kg), in the same form.
        friction (VALUES): Dry friction (N m or N), in the same form.
        joint_limits (FILE): MoveIt's joint_limits.yaml: limits of velocity, effort and
            position instead of the URDF's, and of acceleration and jerk.
        kinematic: Leave out torques, so that the URDF needs no inertias and no torque
            limits: motions keep limits of positions, speeds, accelerations
            (--joint-limits or --acceleration) and jerks.
    """

    package_dir: list[Path] | None = None
    xacro_arg: list[str] | None = None
    srdf: Path | None = None
    group: str | None = None
    limits: Literal["datasheet", "urdf"] | None = None
    lock: list[str] | None = None
    gravity: str | None = None
    effort: str | None = None
    velocity: str | None = None
    position_lower: str | None = None
    position_upper: str | None = None
    damping: str | None = None
    armature: str | None = None
    friction: str | None = None
    joint_limits: Path | None = None
    kinematic: bool = False


@options("Scene")
class SceneOptions(RobotOptions):
    """A robot and its obstacles.

    Attributes:
        scene (FILE): Obstacles of a MoveIt planning scene (.yaml, .scene), in addition
            to --obstacle.
        obstacle (KIND:NAME:...): Obstacle (m), repeatable:
            sphere:NAME:r=R:at=X,Y,Z or box:NAME:size=X,Y,Z:at=X,Y,Z or
            cylinder:NAME:r=R:length=L:at=X,Y,Z or capsule, as a cylinder, or
            mesh:NAME:path=FILE:at=X,Y,Z; each may end in :quat=X,Y,Z,W.
    """

    scene: Path | None = field(default=None, metadata=SCENE)
    obstacle: list[str] | None = field(default=None, metadata=SCENE)


@options("Motion")
class ProblemOptions(SceneOptions):
    """A robot, its obstacles, a start and a goal.

    Attributes:
        start (POSITIONS): Joint positions at the start: numbers in joint order; or the
            name of a group state; or JOINT=VALUE,... for all joints or after the name
            of a group state.
        goal (POSITIONS): Joint positions at the end, in the same form; joints that
            JOINT=VALUE,... leaves out end at their start positions.
        wrap (JOINT,...): Joints of the goal, in addition to continuous joints, whose
            positions are angles modulo a whole turn: the nearest equivalent within the
            limits is the goal; none: no joint wraps, not even a continuous one.
        goal_position (FRAME X Y Z): Bring a frame to a point (m), in any orientation.
        goal_pose (FRAME X Y Z QX QY QZ QW): Bring a frame to a point (m) and an
            orientation (quaternion).
        start_velocity (VALUES): Joint velocities at the start instead of rest.
        start_acceleration (VALUES): Joint accelerations at the start instead of zero,
            for limits of jerk or torque rate.
        goal_velocity (VALUES): Joint velocities at the end instead of rest; for a goal
            on a frame, the three components of its velocity (m/s).
        degrees: Take start and goal of revolute joints in degrees. All other values are
            in SI units.
        request (FILE): Start and goal from a MoveIt motion plan request (.yaml), which
            belongs to a --scene. Joints that its goal leaves out are held at the start.
        margin (LENGTH): Distance to keep from obstacles (m).
        self_collision: Whether the links keep clear of each other too. Default: yes.
        constraint (KIND:KEY=VALUE:...): Constraint along the whole motion, repeatable:
            tool_speed:frame=F:limit=V (m/s) or
            keep_upright:frame=F:axis=X,Y,Z:direction=X,Y,Z:tolerance=A (rad).
        motion_limits (FILE): Limits of accelerations, jerks, torque rates and torques
            over speed: .yaml, see examples/panda_motion_limits.yaml. Options of single
            limits take precedence.
    """

    start: str | None = None
    goal: str | None = None
    wrap: str | None = None
    goal_position: tuple[str, float, float, float] | None = None
    goal_pose: tuple[str, float, float, float, float, float, float, float] | None = None
    start_velocity: str | None = None
    start_acceleration: str | None = None
    goal_velocity: str | None = None
    degrees: bool = False
    request: Path | None = None
    margin: float | None = field(default=None, metadata=SCENE)
    self_collision: bool | None = field(default=None, metadata=SCENE)
    constraint: list[str] | None = None
    motion_limits: Path | None = field(default=None, metadata=ROBOT)


if not TYPE_CHECKING:
    # Limits in addition to the robot's are fields of the library's class.
    ProblemOptions = fields_of(MotionLimits, "Robot", base=ProblemOptions)


def is_scenario(robot: str) -> bool:
    """Whether a scenario file was named instead of a robot."""
    return robot.lower().endswith(".toml")


@options("Output")
class ReportOptions(GeneralOptions):
    """Format of the report.

    Attributes:
        json: Report as JSON.
    """

    json: bool = False


@options("Output")
class PlanOptions(ReportOptions):
    """Warm start of a plan, files to write, and its report.

    Attributes:
        start_from (FILE): Warm start: the motion of a former plan for a similar
            problem: .csv, .npz, .yaml, .json or .mcap.
        output (FILE): Write the motion there: .csv, .npz, or a ROS 2 message (.yaml,
            .json, or .mcap for a bag); replaced if it exists; or - for standard output.
            Default: motion.csv, or motion-2.csv, ... if that exists.
        no_output: Write no motion.
        dt (SECONDS): Time between the rows of the motion. Default: the time of
            --control-period, or the nodes of the grid.
        with_effort: Put the torques into a ROS message too: for controllers that
            command efforts; other controllers refuse it.
        ros_message (NAME): JointTrajectory, FollowJointTrajectory (the goal of that
            action) or RobotTrajectory. Default: JointTrajectory.
        plot (FILE): Plot positions, velocities and torques: .png, .pdf or .svg.
        html (FILE): Write a page that plays the motion: .html.
        certificate (FILE): Plot torques, switching functions, active limits and the
            Hamiltonian, and report how far the motion is from optimal to first order:
            .png, .pdf or .svg.
        sensitivities (FILE): Plot by how much T changes with each limit, and report it:
            .png, .pdf or .svg.
        save_scenario (FILE): Write the problem and the options as a scenario: .toml.
        quiet: No progress and no report, only warnings and errors.
        verbose: Show the log too.
    """

    start_from: Path | None = field(default=None, metadata=PLANNING)
    output: str | None = field(default=None, metadata=OUTPUT_FILE)
    no_output: bool = False
    dt: float | None = None
    with_effort: bool = False
    ros_message: RosMessage | None = None
    plot: Path | None = None
    html: Path | None = None
    certificate: Path | None = None
    sensitivities: Path | None = None
    save_scenario: Path | None = None
    quiet: bool = field(default=False, metadata=QUIET)
    verbose: bool = field(default=False, metadata=VERBOSE)


@options("Output")
class VerifyOptions(ReportOptions):
    """Options of the judgement of a motion.

    Attributes:
        interpolation (NAME): Interpolation between the points: controller (as in ROS's
            joint trajectory controller), linear, cubic, quintic, or auto (the motion
            that was sampled). Default: controller for ROS messages, auto otherwise.
    """

    interpolation: Interpolation | None = field(default=None, metadata=MOTION)


@options("Robot")
class PlayOptions(SceneOptions, GeneralOptions):
    """Robot and obstacles of a motion to show, and the page to write.

    Attributes:
        robot (ROBOT): Name of a robot, path of a URDF file, or a scenario file (.toml).
        output (FILE): Write the page there (.html) instead of opening it in the
            browser.
    """

    robot: str = field(metadata=ROBOT)
    output: Path | None = field(default=None, metadata=OUTPUT | OUTPUT_FILE)
