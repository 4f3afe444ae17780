"""The command ``replay``: arguments, options and help text.

Only light modules are imported here, as each call of the help imports this module.
"""

from __future__ import annotations

from pathlib import Path

from tominpmp.cli.commands import Source
from tominpmp.cli.option_fields import options
from tominpmp.cli.options import ProblemOptions, ReportOptions


@options("Planning")
class ReplayOptions(ReportOptions):
    """Options of the replay of a motion in MuJoCo.

    Attributes:
        step (SECONDS): Longest step of the simulator.
        goal_tolerance (RAD): Largest error of a joint at the end (rad or m), with
            feedback.
        robustness: Instead of replaying a motion, plan with several torque reserves
            and report the least one with which 99 % of trials with random loads,
            friction, delays and noise stay near the motion.
        samples (N): Number of trials for each reserve.
        seed (N): Seed of the random numbers of the trials.
        random_payload (KG): Largest mass that a trial adds to the modelled load.
        random_friction (SHARE): Largest dry friction that a trial adds to the modelled
            friction, as a share of the torque limit of each joint.
        random_delay (SECONDS): Longest time from a measurement to the torque that
            follows from it.
        random_noise (RAD): Standard deviation of measured positions (rad or m).
        tracking_tolerance (RAD): Largest distance of a joint from the motion in a trial
            (rad or m).
        bandwidth (NUMBER): Bandwidth of the feedback in a trial (1/s).
    """

    step: float = 2e-4
    goal_tolerance: float = 0.01
    robustness: bool = False
    samples: int = 100
    seed: int = 0
    random_payload: float = 0.2
    random_friction: float = 0.01
    random_delay: float = 0.002
    random_noise: float = 1e-5
    tracking_tolerance: float = 0.02
    bandwidth: float = 100.0


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
