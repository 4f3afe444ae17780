"""A convex model of an objective near an iterate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array
from tominpmp.transcription.base import Variation


@dataclass(frozen=True, eq=False)
class Model:
    r"""An objective near an iterate z, with a convex model of its change in a step d.

    .. math::
        g^T d + |R d|^2 / 2 + |S d|^2 / 2
        + w \sum (|G (z + d) + G_0| - |G z + G_0|)

    Attributes:
        value: The objective as a function of unknowns and row values.
        gradient: g, shape (size,).
        root: R, root of the curvature, shape (k, size); None without curvature.
        proximal: Diagonal of S, which keeps unknowns near z, shape (size,); None
            without a proximal term.
        variation: G and G_0: differences whose absolute values are added up; None
            without a total variation.
        weight: w, the weight of the total variation.
    """

    value: Callable[[Array, Array], float]
    gradient: Array
    root: sp.csr_matrix | None = None
    proximal: Array | None = None
    variation: Variation | None = None
    weight: float = 0.0

    def without_curvature(self, z: Array) -> float:
        """Linear and total-variation terms at an iterate, up to a constant."""
        total = float(self.gradient @ z)
        if self.variation is not None:
            total += self.weight * self.variation.total(z)
        return total

    def curvature_term(self, step: Array) -> float:
        """Quadratic terms of a step, by the curvature and the proximal term."""
        total = 0.0
        if self.root is not None:
            total += 0.5 * float(np.sum((self.root @ step) ** 2))
        if self.proximal is not None:
            total += 0.5 * float(np.sum((self.proximal * step) ** 2))
        return total

    def with_curvature(self, root: sp.csr_matrix | None) -> Model:
        """The model with a further curvature, given by its root; unchanged for None."""
        if root is None or self.root is None:
            return replace(self, root=self.root if root is None else root)
        return replace(self, root=sp.vstack([self.root, root], format="csr"))
