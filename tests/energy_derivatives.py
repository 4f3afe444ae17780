"""Check of the derivatives of energies of motions by finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from tominpmp.arrays import Array
from tominpmp.solvers.time_and_energy import Energy
from tominpmp.transcription.base import StepBounds

DIRECTIONS = 3


def check_gradient(
    energy: Energy, z: Array, rng: np.random.Generator, step: float, rel: float
) -> None:
    """Assert that an energy and its model have equal values and derivatives.

    Args:
        energy: The energy.
        z: Unknowns of a program.
        rng: Draws random directions.
        step: Scale of the finite differences.
        rel: Largest relative difference of energy and model along the directions.
    """
    far = np.ones(z.size)
    model = energy.model(z, StepBounds(-far, far))
    assert model.value(z, z) == pytest.approx(energy(z), rel=1e-12)
    for _ in range(DIRECTIONS):
        d = step * rng.standard_normal(z.size)
        difference = energy(z + d) - energy(z - d)
        predicted = model.without_curvature(z + d) - model.without_curvature(z - d)
        assert predicted == pytest.approx(difference, rel=rel)
