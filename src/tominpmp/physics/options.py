"""Options of the command ``replay``."""

from __future__ import annotations

from functools import partial
from typing import Annotated, TypeAlias

from tominpmp.arrays import Record
from tominpmp.checks import Amount, positive, whole
from tominpmp.cli.option_fields import options
from tominpmp.cli.options import ReportOptions
from tominpmp.options import Positive, Seed

Step: TypeAlias = Annotated[float, partial(positive, unit="s")]
Deviation: TypeAlias = Annotated[float, partial(positive, unit="rad or m")]
Samples: TypeAlias = Annotated[int, partial(whole, least=1, most=100_000)]


@options("Planning")
class ReplayOptions(ReportOptions, Record):
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

    step: Step = 2e-4
    goal_tolerance: Deviation = 0.01
    robustness: bool = False
    samples: Samples = 100
    seed: Seed = 0
    random_payload: Amount = 0.2
    random_friction: Amount = 0.01
    random_delay: Amount = 0.002
    random_noise: Amount = 1e-5
    tracking_tolerance: Deviation = 0.02
    bandwidth: Positive = 100.0
