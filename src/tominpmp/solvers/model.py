"""An objective near an iterate: as it is, and a convex model of its changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.transcription.base import Variation


@dataclass(frozen=True, eq=False)
class Model:
    r"""An objective near an iterate z, and what it changes by in a step d.

    .. math::
        g^T d + |R d|^2 / 2 + |S d|^2 / 2
        + w \sum (|G (z + d) + G_0| - |G z + G_0|)

    Attributes:
        value: The objective, of unknowns and row values.
        gradient: g, shape (size,).
        root: R, shape (k, size); None where nothing bends.
        near: The diagonal S, which keeps unknowns where they are, shape (size,).
        variation: G and its offset: differences whose sizes count; None for none.
        weight: w, the weight of these.
    """

    value: Callable[[Array, Array], float]
    gradient: Array
    root: sp.csr_matrix | None = None
    near: Array | None = None
    variation: Variation | None = None
    weight: float = 0.0

    def change(self, z: Array, step: Array, *, curved: bool = True) -> float:
        """What the objective changes by in a step.

        Args:
            z: The iterate.
            step: The step.
            curved: Whether the curvature counts.
        """
        change = float(self.gradient @ step)
        if self.variation is not None:
            before, after = self.variation.total(z), self.variation.total(z + step)
            change += self.weight * (after - before)
        if curved and self.root is not None:
            change += 0.5 * float(np.sum((self.root @ step) ** 2))
        if curved and self.near is not None:
            change += 0.5 * float(np.sum((self.near * step) ** 2))
        return change

    def bent(self, root: sp.csr_matrix | None) -> Model:
        """With the root of a further curvature, if there is one."""
        if root is None or self.root is None:
            return replace(self, root=self.root if root is None else root)
        return replace(self, root=sp.vstack([self.root, root], format="csr"))
