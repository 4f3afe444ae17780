"""Check of the derivatives of energies of motions by finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from tominpmp.arrays import Array
from tominpmp.motion.measures import EnergyKind
from tominpmp.solvers.iterate import Iterate
from tominpmp.solvers.time_and_energy import TimeAndEnergy
from tominpmp.transcription.base import StepBounds
from tominpmp.transcription.program import NonlinearProgram

DIRECTIONS = 3
# Weight of the energy with which the duration hardly counts [s per unit of the energy].
HEAVY = 1e6


def check_gradient(
    program: NonlinearProgram,
    kind: EnergyKind,
    z: Array,
    rng: np.random.Generator,
    step: float,
    rel: float,
) -> None:
    """Assert that an energy and its model have equal values and derivatives.

    Args:
        program: The program.
        kind: The kind of energy.
        z: Unknowns of the program.
        rng: Draws random directions.
        step: Scale of the finite differences.
        rel: Largest relative difference of energy and model along the directions.
    """
    objective = TimeAndEnergy(1e-6, 1e-6, kind, HEAVY)
    state, far = Iterate.of(program, z, 1.0), np.ones(z.size)
    linearization = program.linearize(z, state.values, StepBounds(-far, far))
    model = objective.model(program, state, linearization)
    value = objective.value(program, z, state.values)
    assert model.value(z, z) == value
    assert value == pytest.approx(HEAVY * objective.energy(program, z), rel=1e-3)
    for _ in range(DIRECTIONS):
        d = step * rng.standard_normal(z.size)
        after, before = (objective.energy(program, end) for end in (z + d, z - d))
        difference = HEAVY * (after - before)
        predicted = model.without_curvature(z + d) - model.without_curvature(z - d)
        assert predicted == pytest.approx(difference, rel=rel)
