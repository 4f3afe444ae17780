"""The options of the commands: each is declared once, here or by the library.

An option is a field of one of these records, and its text in the help what the
docstring says of the field; what stands in brackets before it is how its value is
called. The options of the planner and the limits beyond a robot's description are the
fields of :class:`~tominpmp.options.Options` and of
:class:`~tominpmp.motion_limits.MotionLimits` themselves, see
:mod:`~tominpmp.cli.option_fields`. Only what is light is imported here, as the help is
made of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, NamedTuple

from tominpmp.cli.option_fields import FieldsOf
from tominpmp.motion_limits import MotionLimits
from tominpmp.options import Options

PlannerOptions = Annotated[
    Mapping[str, Any],
    FieldsOf(
        Options,
        "Planning",
        {
            "max_planning_time": ("--max-time", "Loading the robot counts too."),
            "effort": ("", "Torque limits are --effort."),
        },
        renamed={"effort": "planning_effort"},  # --effort gives torque limits
    ),
]
# What a motion that is judged may be off by.
ToleranceOptions = Annotated[
    Mapping[str, Any], FieldsOf(Options, "Planning", ending="_tolerance")
]
LimitOptions = Annotated[Mapping[str, Any], FieldsOf(MotionLimits, "Robot")]


# What the help lists an option under, if not under the panel of its class.
ROBOT, SCENE, MOTION, PLANNING, OUTPUT = (
    {"panel": panel} for panel in ("Robot", "Scene", "Motion", "Planning", "Output")
)
OUTPUT_FILE = {"flags": ("--output", "-o")}


@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """What is different from the description of a robot.

    Attributes:
        package_dir (FOLDER): Folder in which to look for package://, repeatable.
        srdf (FILE): Semantic description, with the group states. Default: the one
            beside the URDF file.
        group (NAME): Group of the SRDF file whose joints move; the others are held.
        limits (NAME): datasheet: the limits that the maker publishes, accelerations
            among them.
        lock (JOINT=VALUE): Hold a joint at a position (rad or m), repeatable.
        gravity (X Y Z): Gravity (m/s^2) instead of the robot's own.
        effort (VALUES): Torque limits (N m or N) instead of the URDF's: one number for
            all joints; or one for each; or JOINT=VALUE,...
        velocity (VALUES): Velocity limits (rad/s or m/s), likewise.
        position_lower (VALUES): Lower position limits (rad or m), likewise.
        position_upper (VALUES): Upper position limits (rad or m), likewise.
        damping (VALUES): Viscous friction (N m s/rad or N s/m), likewise.
        armature (VALUES): Rotor inertia at the joint (kg m^2), likewise.
        friction (VALUES): Dry friction (N m or N), likewise.
        joint_limits (FILE): MoveIt's joint_limits.yaml: limits of velocity, effort and
            position instead of the URDF's, and of acceleration and jerk.
    """

    panel: ClassVar = "Robot"
    package_dir: list[Path] | None = None
    srdf: Path | None = None
    group: str | None = None
    limits: str | None = None
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


@dataclass(frozen=True, kw_only=True)
class SceneOptions(RobotOptions):
    """A robot and what is around it.

    Attributes:
        scene (FILE): Obstacles of a MoveIt planning scene (.yaml), too.
        obstacle (KIND:NAME:...): Something to stay clear of (m), repeatable:
            sphere:NAME:r=R:at=X,Y,Z or box:NAME:size=X,Y,Z:at=X,Y,Z or
            cylinder:NAME:r=R:length=L:at=X,Y,Z or capsule, as a cylinder, or
            mesh:NAME:path=FILE:at=X,Y,Z; each may end in :quat=X,Y,Z,W.
    """

    scene: Path | None = field(default=None, metadata=SCENE)
    obstacle: list[str] | None = field(default=None, metadata=SCENE)


@dataclass(frozen=True, kw_only=True)
class ProblemOptions(SceneOptions):
    """A robot, what is around it, a start and a goal.

    Attributes:
        start (POSITIONS): Joint positions at the start: numbers in joint order; or the
            name of a group state; or JOINT=VALUE,... for all joints or after such a
            name.
        goal (POSITIONS): Joint positions at the end, likewise; joints that
            JOINT=VALUE,... leaves out end where they started.
        goal_position (FRAME X Y Z): Bring a frame to a point (m), in any orientation.
        goal_pose (FRAME X Y Z QX QY QZ QW): Bring a frame to a point (m) and an
            orientation (quaternion).
        start_velocity (VALUES): Joint velocities at the start instead of rest.
        goal_velocity (VALUES): Joint velocities at the end instead of rest; for a goal
            on a frame, the three components of its velocity (m/s).
        degrees: Take start and goal of joints that turn in degrees. All else is in SI
            units.
        request (FILE): Start and goal from a MoveIt motion plan request (.yaml), which
            belongs to a --scene. Joints that its goal leaves out are held at the start.
        margin (LENGTH): Distance to keep from obstacles (m).
        self_collision: Whether the links keep clear of each other too. Default: they
            do.
        constraint (KIND:KEY=VALUE:...): Something that holds all along the motion,
            repeatable: tool_speed:frame=F:limit=V (m/s) or
            keep_upright:frame=F:axis=X,Y,Z:direction=X,Y,Z:tolerance=A (rad).
        motion_limits (FILE): Limits of accelerations, jerks, torque rates and torques
            over speed: .yaml, see examples/panda_motion_limits.yaml. Those below go
            before it.
    """

    panel: ClassVar = "Motion"
    start: str | None = None
    goal: str | None = None
    goal_position: tuple[str, float, float, float] | None = None
    goal_pose: tuple[str, float, float, float, float, float, float, float] | None = None
    start_velocity: str | None = None
    goal_velocity: str | None = None
    degrees: bool = False
    request: Path | None = None
    margin: float | None = field(default=None, metadata=SCENE)
    self_collision: bool | None = field(default=None, metadata=SCENE)
    constraint: list[str] | None = None
    motion_limits: Path | None = field(default=None, metadata=ROBOT)


class ProblemArguments(NamedTuple):
    """Arguments of a command that make a problem.

    Attributes:
        robot: Name or path of the robot; or a scenario file.
        options: What is different from it, start, goal and obstacles.
        limits: Limits beyond those of the robot, as text by the names of the fields of
            :class:`~tominpmp.motion_limits.MotionLimits`.
    """

    robot: str
    options: ProblemOptions
    limits: Mapping[str, Any] = MappingProxyType({})


def is_scenario(robot: str) -> bool:
    """Whether a scenario file was named instead of a robot."""
    return robot.lower().endswith(".toml")


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """How to report.

    Attributes:
        json: Report as JSON.
    """

    panel: ClassVar = "Output"
    json: bool = False


@dataclass(frozen=True, kw_only=True)
class PlanOptions(ReportOptions):
    """What a plan begins with, what of it to write and what to show.

    Attributes:
        start_from (FILE): Motion of a former plan to begin with, for a problem that is
            much like its own: .csv, .npz, .yaml or .json.
        output (FILE): Write the motion there: .csv, .npz, or a ROS 2 message (.yaml,
            .json, or .mcap for a bag); replaced if it exists; or - for standard output.
            Default: motion.csv, or motion-2.csv, ... if that exists.
        no_output: Write no motion.
        dt (SECONDS): Time between the rows of the motion. Default: that of
            --control-period, or the nodes of the grid.
        with_effort: Put the torques into a ROS message too: for controllers that
            command efforts; others refuse it.
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
    ros_message: str | None = None
    plot: Path | None = None
    html: Path | None = None
    certificate: Path | None = None
    sensitivities: Path | None = None
    save_scenario: Path | None = None
    quiet: bool = field(default=False, metadata={"flags": ("--quiet", "-q")})
    verbose: bool = field(default=False, metadata={"flags": ("--verbose", "-v")})


@dataclass(frozen=True, kw_only=True)
class BatchOptions(ReportOptions):
    """Where a batch is planned, and where its results go.

    Attributes:
        output (FOLDER): Keep the results there, an NPZ file each; what is there from a
            former run is not planned again. Default: results.
        workers (N): How many are planned at once. Default: as many as there are cores.
        backend (NAME): loky (processes), threading, dask, ray, or any other of joblib.
            Default: loky.
        warm_start: Let problems begin with the motions of their neighbours.
        quiet: No progress, only a report, warnings and errors.
    """

    output: Path = field(default=Path("results"), metadata=OUTPUT_FILE)
    workers: int | None = field(default=None, metadata=PLANNING)
    backend: str | None = field(default=None, metadata=PLANNING)
    warm_start: bool = field(default=False, metadata=PLANNING)
    quiet: bool = field(default=False, metadata={"flags": ("--quiet", "-q")})


@dataclass(frozen=True, kw_only=True)
class TourOptions(ReportOptions):
    """What of a tour to write and what to show.

    Attributes:
        output (FILE): Write the whole cycle there: .csv, .npz, or a ROS 2 message
            (.yaml, .json, or .mcap for a bag); replaced if it exists.
        dt (SECONDS): Time between the rows. Default: the nodes of the motions.
        plot (FILE): Draw a Gantt picture: .png, .pdf or .svg.
        html (FILE): Write a page that plays the cycle: .html.
        max_time (SECONDS): Time limit of the planning.
        verbose: Show the log too.
    """

    output: Path | None = field(default=None, metadata=OUTPUT_FILE)
    dt: float | None = None
    plot: Path | None = None
    html: Path | None = None
    max_time: float | None = field(default=None, metadata=PLANNING)
    verbose: bool = field(default=False, metadata={"flags": ("--verbose", "-v")})


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(ReportOptions):
    """How a motion is judged.

    Attributes:
        interpolation (NAME): How the points are joined: controller (as ROS's joint
            trajectory controller), linear, cubic, quintic, or auto (the motion that
            they were taken from). Default: controller for ROS messages, else auto.
    """

    interpolation: str | None = field(default=None, metadata=MOTION)


@dataclass(frozen=True, kw_only=True)
class AppOptions:
    """Where the live page is served.

    Attributes:
        port (N): Port to serve the page at. Default: 8080.
        host (ADDRESS): Address to serve it at; 0.0.0.0 lets others on the network open
            it. Default: 127.0.0.1.
        no_browser: Do not open the page in the browser.
    """

    panel: ClassVar = "Page"
    port: int = 8080
    host: str = "127.0.0.1"
    no_browser: bool = False


@dataclass(frozen=True, kw_only=True)
class ReplayOptions(ReportOptions):
    """How a motion is replayed in MuJoCo.

    Attributes:
        step (SECONDS): Longest step of the simulator. Default: 0.0002.
        goal_tolerance (RAD): What a joint may be off by at the end (rad or m), with
            feedback. Default: 0.01.
        robustness: Instead of replaying a motion, plan with several torque reserves
            and tell which keeps 99 % of random loads, friction, delays and noise near
            the motion.
        samples (N): Number of trials for each reserve. Default: 100.
        seed (N): Of their random numbers.
        random_payload (KG): Largest mass that a trial carries beside what is modelled.
            Default: 0.2.
        random_friction (SHARE): Largest dry friction beside what is modelled, as a
            share of the torque limit of each joint. Default: 0.01.
        random_delay (SECONDS): Longest time from a measurement to the torque that
            follows from it. Default: 0.002.
        random_noise (RAD): Standard deviation of measured positions (rad or m).
            Default: 1e-05.
        tracking_tolerance (RAD): How far a joint may be from the motion in a trial (rad
            or m). Default: 0.02.
        bandwidth (NUMBER): How fast the feedback of a trial brings errors to zero
            (1/s). Default: 100.
    """

    step: float | None = field(default=None, metadata=PLANNING)
    goal_tolerance: float = field(default=0.01, metadata=PLANNING)
    robustness: bool = field(default=False, metadata=PLANNING)
    samples: int = field(default=100, metadata=PLANNING)
    seed: int = field(default=0, metadata=PLANNING)
    random_payload: float = field(default=0.2, metadata=PLANNING)
    random_friction: float = field(default=0.01, metadata=PLANNING)
    random_delay: float = field(default=0.002, metadata=PLANNING)
    random_noise: float = field(default=1e-5, metadata=PLANNING)
    tracking_tolerance: float = field(default=0.02, metadata=PLANNING)
    bandwidth: float = field(default=100.0, metadata=PLANNING)


@dataclass(frozen=True, kw_only=True)
class PlayOptions(SceneOptions):
    """Whose motion is shown, with what around it, and where.

    Attributes:
        robot (ROBOT): Name of a robot, path of a URDF file, or a scenario file (.toml).
        output (FILE): Write the page there (.html) instead of opening it in the
            browser.
    """

    robot: str = field(metadata=ROBOT)
    output: Path | None = field(default=None, metadata=OUTPUT | OUTPUT_FILE)
