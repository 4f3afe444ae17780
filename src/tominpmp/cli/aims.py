"""Options for what a plan aims at, in which form, and what it begins with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tominpmp.cli.arguments import MOTION, OUTPUT, PLANNING, ROBOT, _option

StartFrom = Annotated[
    Path | None,
    _option(
        PLANNING,
        "--start-from",
        "Motion of a former plan to begin with, for a problem that is much like its "
        "own: .csv, .npz, .yaml or .json.",
        "FILE",
    ),
]
Objective = Annotated[
    str | None,
    _option(
        PLANNING,
        "--objective",
        "What to look for: time (the fastest motion) or feasible (the first motion "
        "that keeps all constraints). Default: time.",
        "NAME",
    ),
]
Slack = Annotated[
    float | None,
    _option(
        PLANNING,
        "--slack",
        "Share of the duration to give away for quiet torques, 0.01 say.",
        "SHARE",
    ),
]
MotionLimitsFile = Annotated[
    Path | None,
    _option(
        ROBOT,
        "--motion-limits",
        "Limits of accelerations, jerks, torque rates and torques over speed: .yaml, "
        "see examples/panda_motion_limits.yaml.",
        "FILE",
    ),
]
Group = Annotated[
    str | None,
    _option(
        ROBOT,
        "--group",
        "Group of the SRDF file whose joints move; the others are held.",
        "NAME",
    ),
]
Limits = Annotated[
    str | None,
    _option(
        ROBOT,
        "--limits",
        "datasheet: the limits that the maker publishes, accelerations among them.",
        "NAME",
    ),
]
Control = Annotated[
    str | None,
    _option(
        PLANNING,
        "--control",
        "How accelerations run over an interval: constant, linear, spline or auto. "
        "Default: auto.",
        "NAME",
    ),
]
Refine = Annotated[
    str | None,
    _option(
        PLANNING,
        "--refine",
        "What follows: grid (finer where it is needed) or switching (torques switch at "
        "exact instants).",
        "NAME",
    ),
]
ControlPeriod = Annotated[
    float | None,
    _option(
        PLANNING,
        "--control-period",
        "Period of the controller that takes the motion as samples (s), 0.004 say: "
        "knots and duration become multiples of it.",
        "SECONDS",
    ),
]
Processes = Annotated[
    int | None,
    _option(PLANNING, "--processes", "Processes that try initial guesses.", "N"),
]
CertificatePlot = Annotated[
    Path | None,
    _option(
        OUTPUT,
        "--certificate",
        "Plot torques, switching functions, active limits and the Hamiltonian, and "
        "report how far the motion is from optimal to first order: .png, .pdf or .svg.",
        "FILE",
    ),
]
WithEffort = Annotated[
    bool,
    _option(
        OUTPUT,
        "--with-effort",
        "Put the torques into a ROS message too: for controllers that command efforts; "
        "others refuse it.",
    ),
]
RosMessage = Annotated[
    str | None,
    _option(
        OUTPUT,
        "--ros-message",
        "JointTrajectory, FollowJointTrajectory (the goal of that action) or "
        "RobotTrajectory. Default: JointTrajectory.",
        "NAME",
    ),
]
InterpolationRule = Annotated[
    str | None,
    _option(
        MOTION,
        "--interpolation",
        "How the points are joined: controller (as ROS's joint trajectory controller), "
        "linear, cubic, quintic, or auto (the motion that they were taken from). "
        "Default: controller for ROS messages, else auto.",
        "NAME",
    ),
]
