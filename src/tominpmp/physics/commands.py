"""The command ``replay``: arguments, options and help text.

Only light modules are imported here, as each call of the help imports this module.
"""

from __future__ import annotations

from pathlib import Path

from tominpmp.cli.commands import Source
from tominpmp.cli.options import ProblemOptions
from tominpmp.physics.options import ReplayOptions


def replay(
    scenario: Source,
    motion: Path | None = None,
    /,
    *,
    changes: ProblemOptions = ProblemOptions(),
    args: ReplayOptions = ReplayOptions(),
) -> int:
    """Replay a motion in MuJoCo: by its torques alone, and with feedback.

    MuJoCo comes with the extra "mujoco". With --robustness, motions are planned
    with several torque reserves instead, and each is tried with random loads,
    friction, delays and noise.

    Exit codes:
        0    the motion with feedback ends at its goal, or a reserve suffices
        1    it does not, or no reserve suffices
        2    bad input
        74   the report cannot be written to standard output
        129  the terminal was closed (SIGHUP)
        130  interrupted (Ctrl-C)
        143  terminated (SIGTERM)

    Args:
        scenario: Scenario file (.toml); or a robot, with --scene and --request, or with
            --start and a goal.
        motion: File with the motion, as for verify.
        changes: Options of the problem.
        args: Options of the command.
    """
    from tominpmp.physics.replay_command import run_replay

    return run_replay(scenario, changes, motion, args)
