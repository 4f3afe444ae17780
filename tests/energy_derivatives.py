"""Derivatives of energies of motions against differences."""

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
    """Assert that an energy is its model's, and changes as that along random steps.

    Args:
        energy: The energy.
        z: Where.
        rng: Draws the directions.
        step: How far the differences reach.
        rel: How far apart both may be, as a share.
    """
    far = np.ones(z.size)
    model = energy.model(z, StepBounds(-far, far))
    assert model.value(z, z) == pytest.approx(energy(z), rel=1e-12)
    for _ in range(DIRECTIONS):
        d = step * rng.standard_normal(z.size)
        difference = energy(z + d) - energy(z - d)
        promised = model.without_curvature(z + d) - model.without_curvature(z - d)
        assert promised == pytest.approx(difference, rel=rel)
