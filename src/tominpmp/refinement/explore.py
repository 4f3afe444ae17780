"""Other structures: random arcs, of which some lead to other local optima.

Time-optimal motions of the same arm between the same states often come in several
kinds that differ by the order of the switches, and no small change leads from one to
another.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tominpmp.refinement.arcs import Arcs
from tominpmp.refinement.switching import (
    Budget,
    Settled,
    refine_arcs,
    solve_lengths,
)
from tominpmp.transcription.controls import driven_joints
from tominpmp.transcription.system import System

# Arcs of a random structure beyond twice the number of motors.
EXTRA_ARCS = 2
# How its duration is spread about the best known one, as a logarithm.
SPREAD = 0.2
# A joint rarely switches twice in a row.
AGAIN = 0.3
# Steps over a whole motion and motions integrated in a first, rough solve.
ROUGH_STEPS = 24
ROUGH_SHOTS = 80
# What it may miss the goal by, and its duration, as a multiple of the best, to go on.
PROMISING = 1e-2
WORTH_IT = 1.02


def random_arcs(system: System, duration: float, rng: np.random.Generator) -> Arcs:
    """Torques at their limits that switch at random.

    Args:
        system: The functions of the problem.
        duration: About how long the motion takes [s].
        rng: Random numbers.
    """
    joints = driven_joints(system)
    count = 2 * joints.size + EXTRA_ARCS
    signs = np.zeros(system.n)
    signs[joints] = rng.choice([-1.0, 1.0], size=joints.size)
    levels, last = [signs.copy()], -1
    for _ in range(count - 1):
        pick = int(rng.integers(joints.size))
        if pick == last and joints.size > 1 and rng.random() > AGAIN:
            pick = (pick + 1) % joints.size
        signs[joints[pick]] *= -1.0
        levels.append(signs.copy())
        last = pick
    lengths = rng.dirichlet(np.full(count, 2.0)) * duration
    lengths *= np.exp(rng.normal(0.0, SPREAD))
    none = np.zeros((count, system.n), dtype=np.int64)
    return Arcs(lengths, np.array(levels), none.astype(bool), none)


def explore(
    system: System,
    duration: float,
    rng: np.random.Generator,
    tries: int,
    budget: Budget,
) -> Iterator[Settled]:
    """Locally optimal motions of other structures, each faster than those before.

    Args:
        system: The functions of the problem.
        duration: T to be beaten [s].
        rng: Random numbers.
        tries: Number of random structures.
        budget: How much may be spent in all.

    Yields:
        Motions that keep goal and limits.
    """
    for _ in range(tries):
        if budget.spent:
            return
        rough = _rough(system, random_arcs(system, duration, rng), budget)
        if rough is None or rough.miss > PROMISING:
            continue
        if rough.duration > WORTH_IT * duration:
            continue
        found = refine_arcs(system, rough.arcs.cleaned(), rough.states, budget)
        if found is not None and found.duration < duration:
            duration = found.duration
            yield found


def _rough(system: System, arcs: Arcs, budget: Budget) -> Settled | None:
    """A first solve on few steps, from torques that lead anywhere."""
    part = budget.part(ROUGH_SHOTS)
    found = solve_lengths(system, arcs, None, part, ROUGH_STEPS)
    budget.take(part)
    return found
