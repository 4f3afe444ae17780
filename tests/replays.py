"""Replays of the torques of a motion."""

from __future__ import annotations

import tominpmp as tm
from tominpmp.verification.replay import Integration, Integrator, Replay


def replay(
    problem: tm.Problem, motion: tm.Trajectory, integrator: Integrator | None = None
) -> Replay:
    """Integrate the torques of a motion from the start of a problem."""
    return Integration(problem.robot, motion, integrator=integrator).run(
        problem.x_start
    )
