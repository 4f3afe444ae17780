r"""Exact penalty merit: an objective and the violations of its limits.

.. math::
    \phi(z) = f(z) + \sum_g \mu_g \max_{i \in g} v_i(z)

with the violations v of the rows of a group g. It is exact when each weight is above
the sum of the multipliers of its group (Fletcher, 1987); the program of an iteration
has one elastic variable a group for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tominpmp.arrays import Array
from tominpmp.transcription.rows import Rows

# Weights stay this much above the multipliers seen.
WEIGHT_MARGIN = 1.5
# A violation counts as left alone if this share of it remains.
STUCK = 0.95
# Violations below this need no elastic variable.
NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class Merit:
    """Weights of the violations in the merit function.

    Attributes:
        rows: What the rows are.
        weights: Weight mu of each kind of row [s], shape (kinds,).
    """

    rows: Rows
    weights: Array

    def penalty(self, values: Array) -> float:
        """Weighted violations [s]."""
        violation = self.rows.group_violation(values)
        return float(self.weights[self.rows.group_kind] @ violation)

    def raised(self, multipliers: Array, before: Array, promised: Array) -> Merit:
        """Raise the weights above the multipliers of a program.

        Those of a group with an elastic variable add up to its weight at most and say
        nothing about it; its weight is doubled where the program would leave the
        violation as it is.

        Args:
            multipliers: Of all rows, shape (m,).
            before: Row values, shape (m,).
            promised: Row values that the program promises, shape (m,).
        """
        violation = self.rows.group_violation(before)
        after = self.rows.group_violation(promised)
        elastic = violation > NEGLIGIBLE
        groups = np.zeros(elastic.size)
        np.add.at(groups, self.rows.group, np.abs(multipliers))
        kind = self.rows.group_kind
        needed = np.zeros_like(self.weights)
        np.maximum.at(needed, kind[~elastic], WEIGHT_MARGIN * groups[~elastic])
        stuck = np.zeros(self.weights.size, dtype=bool)
        stuck[kind[elastic & (after > STUCK * violation)]] = True
        weights = np.where(stuck, 2.0 * self.weights, self.weights)
        return replace(self, weights=np.maximum(weights, needed))

    def scaled(self, factor: float) -> Merit:
        """Multiply all weights."""
        return replace(self, weights=factor * self.weights)
