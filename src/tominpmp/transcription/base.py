"""The small interface between a transcription and the solvers.

A transcription turns a problem into a nonlinear program in a vector z, with an
objective that is linear in z (the duration) and rows lower <= g(z) <= upper, scaled so
that a violation of 1 means about "by 100 %". The solvers know nothing else of robots.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray
from tominpmp.trajectory import Trajectory


@dataclass(frozen=True)
class Rows:
    """What the rows of a program are.

    Attributes:
        lower: Lower bounds, shape (m,).
        upper: Upper bounds, shape (m,); equal to the lower ones for equations.
        kind: Index into ``kinds`` for each row, shape (m,).
        group: Rows of one group share an elastic variable, shape (m,).
        kinds: Names of the kinds, for reports.
    """

    lower: Array
    upper: Array
    kind: IntArray
    group: IntArray
    kinds: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.lower.size

    def violation(self, values: Array) -> Array:
        """Violation of each row, >= 0, shape (m,)."""
        excess = np.maximum(self.lower - values, values - self.upper)
        return np.asarray(np.maximum(excess, 0.0))

    def group_violation(self, values: Array) -> Array:
        """Largest violation in each group, shape (number of groups,)."""
        count = int(self.group.max()) + 1 if self.size else 0
        out = np.zeros(count)
        np.maximum.at(out, self.group, self.violation(values))
        return out

    @property
    def group_kind(self) -> IntArray:
        """Kind of each group, shape (number of groups,)."""
        count = int(self.group.max()) + 1 if self.size else 0
        out = np.zeros(count, dtype=np.int64)
        out[self.group] = self.kind
        return out

    @staticmethod
    def stack(parts: list[tuple[str, Array, Array, IntArray]]) -> Rows:
        """Join blocks of rows.

        Args:
            parts: For each block: name of its kind, lower and upper bounds, and groups
                counted from 0 within the block.

        Returns:
            The rows of all blocks, in order.
        """
        kinds = tuple(part[0] for part in parts)
        lower, upper, kind, group = [], [], [], []
        first = 0
        for index, (_, low, high, groups) in enumerate(parts):
            lower.append(low)
            upper.append(high)
            kind.append(np.full(low.size, index, dtype=np.int64))
            group.append(groups.astype(np.int64) + first)
            first += int(groups.max()) + 1 if groups.size else 0
        return Rows(
            np.concatenate(lower),
            np.concatenate(upper),
            np.concatenate(kind),
            np.concatenate(group),
            kinds,
        )


class Linearization(NamedTuple):
    """Jacobian of some rows.

    Attributes:
        rows: Indices of the rows that can matter for the step, shape (k,).
        matrix: Their Jacobian, shape (k, size).
    """

    rows: IntArray
    matrix: sp.csr_matrix


class StepBounds(NamedTuple):
    """Box for the step of one linear program.

    Attributes:
        lower: Shape (size,), <= 0.
        upper: Shape (size,), >= 0.
    """

    lower: Array
    upper: Array


class Variation(NamedTuple):
    """Differences of neighbouring controls in full ranges, G z + offset.

    Attributes:
        matrix: G, shape (k, size).
        offset: Shape (k,).
    """

    matrix: sp.csr_matrix
    offset: Array

    def total(self, z: Array) -> float:
        """Sum of the absolute differences."""
        return float(np.abs(self.matrix @ z + self.offset).sum())


class Transcription(Protocol):
    """A problem as a nonlinear program; see the module."""

    @property
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def rows(self) -> Rows:
        """What the rows are."""

    @property
    def cost(self) -> Array:
        """Gradient of the duration, which is cost @ z, shape (size,)."""

    def evaluate(self, z: Array) -> Array:
        """Row values g(z), shape (m,)."""

    def linearize(self, z: Array, values: Array, steps: StepBounds) -> Linearization:
        """Jacobian of the rows that can become active within a box of steps."""

    def step_bounds(self, z: Array, radius: float) -> StepBounds:
        """Box of steps: the trust region of a radius [rad] within the bounds of z."""

    def variation(self, z: Array) -> Variation:
        """Differences of the controls, as a linear function near z."""

    def stretch(self, z: Array, factor: float) -> Array:
        """The same path, slower by a factor."""

    def trajectory(self, z: Array) -> Trajectory:
        """The motion of an iterate."""
