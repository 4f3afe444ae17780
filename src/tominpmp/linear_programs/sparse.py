"""Sparse matrices from tables of entries."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from tominpmp.arrays import Array, IntArray


def rows_of_table(data: Array, places: IntArray, width: int) -> sp.csr_matrix:
    """Sparse matrix whose rows have up to w entries each; zeros are left out.

    The rows are written as they are stored: from coordinates SciPy would sort them.

    Args:
        data: Entries, shape (m, w).
        places: Their columns in ascending order, shape (m, w); -1 to leave an entry
            out.
        width: Number of columns.
    """
    used = (data != 0.0) & (places >= 0)
    # SciPy and the solvers accept this index type without a copy.
    starts = np.zeros(len(data) + 1, dtype=np.int32)
    np.cumsum(used.sum(axis=1), out=starts[1:])
    columns = places[used].astype(np.int32)
    return sp.csr_matrix((data[used], columns, starts), shape=(len(data), width))
