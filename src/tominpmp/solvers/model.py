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

    def straight(self, z: Array) -> float:
        """What it has without its curvature, but for a constant."""
        total = float(self.gradient @ z)
        if self.variation is not None:
            total += self.weight * self.variation.total(z)
        return total

    def bend(self, step: Array) -> float:
        """What its curvature adds for a step."""
        total = 0.0
        if self.root is not None:
            total += 0.5 * float(np.sum((self.root @ step) ** 2))
        if self.near is not None:
            total += 0.5 * float(np.sum((self.near * step) ** 2))
        return total

    def bent(self, root: sp.csr_matrix | None) -> Model:
        """With the root of a further curvature, if there is one."""
        if root is None or self.root is None:
            return replace(self, root=self.root if root is None else root)
        return replace(self, root=sp.vstack([self.root, root], format="csr"))
