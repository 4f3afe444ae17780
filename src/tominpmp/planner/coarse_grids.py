"""Coarse grids for starts, and the grids on which what they led to is gone on with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.initial_guess.constrained import speed_used
from tominpmp.initial_guess.guess import Guess
from tominpmp.options import Options
from tominpmp.planner.direct_solve import by_squares
from tominpmp.transcription.bspline import DEGREES
from tominpmp.transcription.problem_functions import ProblemFunctions

# Intervals of grids from which on a coarser one pays.
LEAST_INTERVALS = 24
# A guess is held by speed limits where a joint is at one for this share of the time,
# from this share of it on: torques do not rule it then.
SPEED_SHARE, AT_LIMIT = 0.6, 0.97
# Intervals of a coarse grid.
INTERVALS = 16
# What it costs, as a share of T, where torques rule and where speeds do.
TORQUE_LOSS, SPEED_LOSS = 0.06, 0.01
# How exactly a coarse motion is found, and in how many iterations: it is gone on with.
TOLERANCE = 2e-3
ITERATIONS = 30
# Trust region for going on from a coarse motion, as a share of the usual one.
RADIUS = 0.5
# Intervals at once, at most, where torques rule and the grid may follow the motion, and
# joints times intervals: programs of thirty joints take a second each.
TORQUE_INTERVALS, TORQUE_VARIABLES = 80, 640


def suits(system: ProblemFunctions, options: Options) -> bool:
    """Whether coarse grids are for a problem, and for these options."""
    return (
        options.method == "inverse"
        and options.objective == "time"
        and options.intervals >= LEAST_INTERVALS
        and not system.parts
    )


def torques_rule(system: ProblemFunctions, guess: Guess) -> bool:
    """Whether torques rule a motion along a guess, rather than speed limits."""
    if not guess.timed:
        return True
    v = np.diff(guess.q, axis=0) / np.diff(guess.t)[:, None]
    used = speed_used(system.problem, 0.5 * (guess.q[1:] + guess.q[:-1]), v)
    return bool(np.mean(used > AT_LIMIT) < SPEED_SHARE)


@dataclass(frozen=True, eq=False)
class Grids:
    """How a guess is improved on a coarse grid, and how what it led to is gone on with.

    Attributes:
        coarse: Options for the coarse grid.
        fine: Options for the grid that is asked for.
    """

    coarse: Options
    fine: Options

    @classmethod
    def of(cls, system: ProblemFunctions, options: Options, torques: bool) -> Grids:
        """Grids that suit a problem.

        Where torques rule, continuous accelerations on even intervals lose least; where
        speeds and obstacles do, constant ones on short intervals at both ends. A weight
        on the variation of torques leads to better optima on the coarse grid; on the
        fine one it costs 0.1 % of T. If the grid may follow the motion anyway, torques
        get twice the intervals at once: that ends 0.1 to 0.5 % lower (six goals).

        Args:
            system: The problem.
            options: Options of the plan.
            torques: Whether torques rule the motion.
        """
        coarse = replace(
            options,
            intervals=INTERVALS,
            refine=None,
            tolerance=max(options.tolerance, TOLERANCE),
            max_iterations=min(options.max_iterations, ITERATIONS),
        )
        fine = replace(options, trust_region=RADIUS * options.trust_region)
        if torques and (system.alone or by_squares(system, options)):
            fine = replace(fine, smoothing=options.smoothing or 0.0)
        if torques and system.alone:
            control = options.control if options.control in DEGREES else "linear"
            coarse = replace(coarse, grid="uniform", control=control)
            if options.control == "auto" and options.refine in (None, "auto"):
                fine = replace(fine, control="linear")
            if options.refine == "auto":
                most = min(TORQUE_INTERVALS, TORQUE_VARIABLES // system.n)
                finer = min(2 * options.intervals, most)
                fine = replace(fine, intervals=max(options.intervals, finer))
        return cls(coarse, fine)
