r"""Exact penalty merit: duration, variation of the controls and violations.

.. math::
    \phi(z) = T(z) + \gamma \, TV(z) + \sum_g \mu_g \max_{i \in g} v_i(z)

with the violations v of the rows of a group g. It is exact when each weight is above the
sum of the multipliers of its group (Fletcher, 1987); the linear program of an iteration
has one elastic variable a group for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.transcription.base import Rows, Variation

# Weights stay this much above the multipliers seen.
WEIGHT_MARGIN = 1.5
# Violations below this need no elastic variable.
NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class Merit:
    """Weights of the merit function.

    Attributes:
        cost: Gradient of the duration.
        rows: What the rows are.
        smoothing: Weight gamma of the total variation [s].
        weights: Weight mu of each kind of row [s], shape (kinds,).
    """

    cost: Array
    rows: Rows
    smoothing: float
    weights: Array

    def __call__(self, z: Array, values: Array, variation: Variation | None) -> float:
        """Merit of an iterate [s]."""
        total = float(self.cost @ z)
        if variation is not None:
            total += self.smoothing * variation.total(z)
        return total + self.penalty(values)

    def penalty(self, values: Array) -> float:
        """Weighted violations [s]."""
        violation = self.rows.group_violation(values)
        return float(self.weights[self.rows.group_kind] @ violation)

    def raised(self, multipliers: Array) -> Merit:
        """Raise the weights above the multipliers of all rows, shape (m,)."""
        groups = np.zeros(self.rows.group_kind.size)
        np.add.at(groups, self.rows.group, np.abs(multipliers))
        needed = np.zeros_like(self.weights)
        np.maximum.at(needed, self.rows.group_kind, WEIGHT_MARGIN * groups)
        return replace(self, weights=np.maximum(self.weights, needed))

    def scaled(self, factor: float) -> Merit:
        """Multiply all weights."""
        return replace(self, weights=factor * self.weights)
