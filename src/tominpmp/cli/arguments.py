"""The arguments and options of the commands, with their texts in the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# What the options are listed under in the help, in this order.
MOTION = "Motion"
SCENE = "Scene"
ROBOT = "Robot"
PLANNING = "Planning"
OUTPUT = "Output"
GENERAL = "General"
PANELS = (MOTION, SCENE, ROBOT, PLANNING, OUTPUT, GENERAL)

# Options whose values may be typed as one word, or as several.
LIST_OPTIONS = frozenset(
    f"--{name}"
    for name in (
        "start",
        "goal",
        "start-velocity",
        "goal-velocity",
        "gravity",
        "effort",
        "velocity",
        "damping",
        "armature",
        "friction",
    )
)

Position = tuple[str, float, float, float]
Pose = tuple[str, float, float, float, float, float, float, float]


def _option(
    panel: str, names: str, text: str, metavar: str | None = None
) -> typer.models.OptionInfo:
    option: typer.models.OptionInfo = typer.Option(
        *names.split(),
        metavar=metavar,
        help=text,
        rich_help_panel=panel,
        show_default=False,
    )
    return option


RobotName = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="Name of a robot (tominpmp robots lists them) or path of a URDF file.",
        show_default=False,
    ),
]
PlannedRobot = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="Name of a robot (tominpmp robots lists them) or path of a URDF file; or "
        "a scenario file (.toml), which holds robot, start, goal, scene and options.",
        show_default=False,
    ),
]
JudgedProblem = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Scenario file (.toml); or a robot, with --scene and --request.",
        show_default=False,
    ),
]
MovingRobot = Annotated[
    str,
    _option(
        ROBOT,
        "--robot",
        "Name of a robot, path of a URDF file, or a scenario file (.toml).",
        "ROBOT",
    ),
]
RecordedMotion = Annotated[
    Path,
    typer.Argument(
        metavar="MOTION",
        help="File with a motion: .csv or .npz, as tominpmp plan writes it, or a ROS 2 "
        "message or bag with a JointTrajectory (.yaml, .json, .mcap).",
        show_default=False,
    ),
]

Start = Annotated[
    str | None,
    _option(
        MOTION,
        "--start",
        "Joint positions at the start: numbers in joint order; or the name of a group "
        "state; or JOINT=VALUE,... for all joints or after such a name.",
        "POSITIONS",
    ),
]
Goal = Annotated[
    str | None,
    _option(
        MOTION,
        "--goal",
        "Joint positions at the end, likewise; joints that JOINT=VALUE,... leaves out "
        "end where they started.",
        "POSITIONS",
    ),
]
GoalPosition = Annotated[
    Position | None,
    _option(
        MOTION,
        "--goal-position",
        "Bring a frame to a point (m), in any orientation.",
        "FRAME X Y Z",
    ),
]
GoalPose = Annotated[
    Pose | None,
    _option(
        MOTION,
        "--goal-pose",
        "Bring a frame to a point (m) and an orientation (quaternion).",
        "FRAME X Y Z QX QY QZ QW",
    ),
]
StartVelocity = Annotated[
    str | None,
    _option(
        MOTION,
        "--start-velocity",
        "Joint velocities at the start instead of rest.",
        "VALUES",
    ),
]
GoalVelocity = Annotated[
    str | None,
    _option(
        MOTION,
        "--goal-velocity",
        "Joint velocities at the end instead of rest; for a goal on a frame, the three "
        "components of its velocity (m/s).",
        "VALUES",
    ),
]
Degrees = Annotated[
    bool,
    _option(
        MOTION,
        "--degrees",
        "Take start and goal of joints that turn in degrees. All else is in SI units.",
    ),
]

Obstacles = Annotated[
    list[str] | None,
    _option(
        SCENE,
        "--obstacle",
        "Something to stay clear of (m), repeatable: sphere:NAME:r=R:at=X,Y,Z or "
        "box:NAME:size=X,Y,Z:at=X,Y,Z or cylinder:NAME:r=R:length=L:at=X,Y,Z or "
        "capsule, as a cylinder; each may end in :quat=X,Y,Z,W.",
        "KIND:NAME:...",
    ),
]
Margin = Annotated[
    float | None,
    _option(SCENE, "--margin", "Distance to keep from obstacles (m).", "LENGTH"),
]
MoveItScene = Annotated[
    Path | None,
    _option(
        SCENE, "--scene", "Obstacles of a MoveIt planning scene (.yaml), too.", "FILE"
    ),
]
MoveItRequest = Annotated[
    Path | None,
    _option(
        MOTION,
        "--request",
        "Start and goal from a MoveIt motion plan request (.yaml), which belongs to a "
        "--scene. Joints that its goal leaves out are held at the start.",
        "FILE",
    ),
]

PackageDirs = Annotated[
    list[Path] | None,
    _option(
        ROBOT,
        "--package-dir",
        "Folder in which to look for package://, repeatable.",
        "FOLDER",
    ),
]
Srdf = Annotated[
    Path | None,
    _option(
        ROBOT,
        "--srdf",
        "Semantic description, with the group states. Default: the one beside the URDF "
        "file.",
        "FILE",
    ),
]
Locks = Annotated[
    list[str] | None,
    _option(
        ROBOT,
        "--lock",
        "Hold a joint at a position (rad or m), repeatable.",
        "JOINT=VALUE",
    ),
]
JointLimitsFile = Annotated[
    Path | None,
    _option(
        ROBOT,
        "--joint-limits",
        "MoveIt's joint_limits.yaml: limits of velocity, effort and position instead "
        "of the URDF's, and of acceleration and jerk.",
        "FILE",
    ),
]
Gravity = Annotated[
    str | None,
    _option(ROBOT, "--gravity", "Gravity (m/s^2) instead of the robot's own.", "X Y Z"),
]
Effort = Annotated[
    str | None,
    _option(
        ROBOT,
        "--effort",
        "Torque limits (N m or N) instead of the URDF's: one number for all joints; or "
        "one for each; or JOINT=VALUE,...",
        "VALUES",
    ),
]
Velocity = Annotated[
    str | None,
    _option(ROBOT, "--velocity", "Velocity limits (rad/s or m/s), likewise.", "VALUES"),
]
Damping = Annotated[
    str | None,
    _option(
        ROBOT,
        "--damping",
        "Viscous friction (N m s/rad or N s/m), likewise.",
        "VALUES",
    ),
]
Armature = Annotated[
    str | None,
    _option(
        ROBOT, "--armature", "Rotor inertia at the joint (kg m^2), likewise.", "VALUES"
    ),
]
Friction = Annotated[
    str | None,
    _option(ROBOT, "--friction", "Dry friction (N m or N), likewise.", "VALUES"),
]

Method = Annotated[
    str | None,
    _option(
        PLANNING,
        "--method",
        "inverse, collocation, adjoint, penalty or auto. Default: auto.",
        "METHOD",
    ),
]
Intervals = Annotated[
    int | None,
    _option(PLANNING, "--intervals", "Number of intervals of the time grid.", "N"),
]
Smoothing = Annotated[
    float | None,
    _option(
        PLANNING,
        "--smoothing",
        "Weight of the variation of the controls (s per full range).",
        "WEIGHT",
    ),
]
Starts = Annotated[
    int | None,
    _option(
        PLANNING,
        "--starts",
        "Number of initial guesses; the fastest motion counts.",
        "N",
    ),
]
Seed = Annotated[
    int | None, _option(PLANNING, "--seed", "Seed of everything random.", "N")
]
MaxTime = Annotated[
    float | None,
    _option(
        PLANNING,
        "--max-time",
        "Time limit for loading and planning (s); then the best motion so far counts.",
        "SECONDS",
    ),
]
MaxIterations = Annotated[
    int | None,
    _option(PLANNING, "--max-iterations", "Largest number of iterations a guess.", "N"),
]
LpSolver = Annotated[
    str | None,
    _option(
        PLANNING,
        "--lp-solver",
        "Solver of the linear programs: highs, piqp, any other that qpsolvers knows, "
        "or auto. Default: auto.",
        "NAME",
    ),
]

MotionFile = Annotated[
    str | None,
    _option(
        OUTPUT,
        "--output -o",
        "Write the motion there: .csv, .npz, or a ROS 2 message (.yaml, .json, or "
        ".mcap for a bag); replaced if it exists; or - for standard output. Default: "
        "motion.csv, or motion-2.csv, ... if that exists.",
        "FILE",
    ),
]
NoOutput = Annotated[bool, _option(OUTPUT, "--no-output", "Write no motion.")]
Dt = Annotated[
    float | None,
    _option(
        OUTPUT,
        "--dt",
        "Time between the rows of the motion. Default: that of --control-period, or "
        "the nodes of the grid.",
        "SECONDS",
    ),
]
Plot = Annotated[
    Path | None,
    _option(
        OUTPUT,
        "--plot",
        "Plot positions, velocities and torques: .png, .pdf or .svg.",
        "FILE",
    ),
]
SaveScenario = Annotated[
    Path | None,
    _option(
        OUTPUT,
        "--save-scenario",
        "Write the problem and the options as a scenario: .toml.",
        "FILE",
    ),
]
Html = Annotated[
    Path | None,
    _option(OUTPUT, "--html", "Write a page that plays the motion: .html.", "FILE"),
]
Page = Annotated[
    Path | None,
    _option(
        OUTPUT,
        "--output -o",
        "Write the page there (.html) instead of opening it in the browser.",
        "FILE",
    ),
]
Json = Annotated[bool, _option(OUTPUT, "--json", "Report as JSON.")]
Quiet = Annotated[
    bool,
    _option(
        OUTPUT, "--quiet -q", "No progress and no report, only warnings and errors."
    ),
]
Verbose = Annotated[bool, _option(OUTPUT, "--verbose -v", "Show the log too.")]
Debug = Annotated[
    bool, _option(GENERAL, "--debug", "Show the traceback of an error too.")
]
