"""Replays of the torques of a motion."""

from __future__ import annotations

import tominpmp as tm
from tominpmp.verification.plant import Plant
from tominpmp.verification.replay import (
    Integration,
    Integrator,
    Replay,
    torque_pieces,
)


def integration(
    robot: tm.Robot,
    motion: tm.Trajectory,
    integrator: Integrator | None = None,
    tightness: float = 1.0,
) -> Integration:
    """The integration of the torques of a motion of one segment."""
    torque = torque_pieces(robot, motion)
    return Integration([Plant(robot)], motion, torque, integrator, tightness)


def replay(
    problem: tm.Problem, motion: tm.Trajectory, integrator: Integrator | None = None
) -> Replay:
    """Integrate the torques of a motion from the start of a problem."""
    return integration(problem.robot, motion, integrator).run(problem.x_start)
