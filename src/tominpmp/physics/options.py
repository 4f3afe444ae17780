"""Options of the command ``replay``."""

from __future__ import annotations

from dataclasses import dataclass

from tominpmp.cli.option_fields import options
from tominpmp.cli.options import ReportOptions


@options("Planning")
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

    step: float | None = None
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
