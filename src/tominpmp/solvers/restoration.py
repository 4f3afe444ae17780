"""Slowing down: the cure for the last violations of torques and speeds.

A motion that is slower by half of such a violation keeps the limit, and costs that
much; another linear program would do no better where the violation is small.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tominpmp.solvers.iterate import Iterate
from tominpmp.transcription.base import Program

# Violations below this are removed by slowing down at the end.
RESTORABLE = 1e-2
RESTORATIONS = 8
# Share of a violation that cures it, as torques go with the square of the pace, and
# how much more than what is needed is tried.
HALF, MORE = 0.5, 1.02
# Violations between the rows below this are cured so, where the grid is to be refined
# anyway: programs with rows for them bring less than it costs.
LIGHT = 5e-4


def restorable(nlp: Program, iterate: Iterate, limit: float) -> bool:
    """Whether slowing down can remove what violation is left: not of equations.

    Args:
        nlp: The program.
        iterate: An iterate of it.
        limit: Largest violation that is let pass.
    """
    rows = nlp.rows
    violation = rows.violation(iterate.values)
    equations = violation[rows.lower == rows.upper]
    return bool(
        np.max(violation, initial=0.0) <= RESTORABLE
        and np.max(equations, initial=0.0) <= limit
    )


def restored(nlp: Program, iterate: Iterate, limit: float) -> Iterate:
    """Slow a motion down until it keeps the limits, where that is enough.

    The iteration stops when the duration has settled, which may be before the last
    second-order errors are gone; slowing down by half of such an error removes it.

    Args:
        nlp: The program.
        iterate: An iterate of it.
        limit: Largest violation that is let pass.
    """
    if iterate.violation <= limit or not restorable(nlp, iterate, limit):
        return iterate
    best, low, high = iterate, 1.0, np.inf
    left, falls = iterate.violation, 0.0
    factor = 1.0 + HALF * left
    for _ in range(RESTORATIONS):
        z, values = nlp.slower(iterate.z, factor, iterate.values)
        trial = replace(iterate, z=z, values=values)
        if trial.violation <= limit:
            best, high = trial, factor
            if falls > 0.0:
                break
        else:
            falls = max((left - trial.violation) / (factor - low), 0.0)
            low, left = factor, trial.violation
        # Where what is left falls as evenly as it did, there is none a little beyond.
        beyond = low + MORE * left / falls if falls > 0.0 else np.inf
        if np.isinf(high):
            factor = min(beyond, 1.0 + 2.0 * (factor - 1.0))
        else:
            factor = beyond if beyond < high else 0.5 * (low + high)
    return best


def cured(nlp: Program, iterate: Iterate, light: float, limit: float) -> Iterate | None:
    """A motion with light violations, so slow that it has none.

    Args:
        nlp: The program.
        iterate: An iterate of it.
        light: The largest violation that is light.
        limit: Largest violation that is let pass.

    Returns:
        The motion; None if its violations are not light, or slowing down is no cure.
    """
    rows = nlp.rows
    violation = rows.violation(iterate.values)
    curable = rows.curable[rows.kind]
    if np.max(violation, initial=0.0) > light or np.any(violation[~curable] > limit):
        return None
    slower = restored(nlp, iterate, limit)
    return slower if slower.violation <= limit else None
