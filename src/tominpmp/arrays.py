"""The array type of the library, and how arrays become read-only.

Problem data are frozen: the arrays in them cannot be written to, so that a problem that
was checked once stays as it was checked.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen_array(values: ArrayLike) -> Array:
    """Copy values into a read-only array of floats.

    Args:
        values: Anything NumPy can turn into an array.

    Returns:
        A new array of the same shape that cannot be written to.
    """
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
