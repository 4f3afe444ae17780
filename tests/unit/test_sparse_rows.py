"""Sparse matrices from tables of entries."""

from __future__ import annotations

import numpy as np

from tominpmp.transcription.curve import rows_of_table


def test_rows_of_table_drops_zeros_and_entries_without_a_column() -> None:
    data = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0], [3.0, 4.0, 5.0]])
    places = np.array([[0, 2, 3], [0, 1, 2], [-1, 1, 3]])
    found = rows_of_table(data, places, 4)
    found.check_format(full_check=True)
    assert found.nnz == 4
    expected = [[1.0, 0.0, 2.0, 0.0], [0.0] * 4, [0.0, 4.0, 0.0, 5.0]]
    np.testing.assert_array_equal(found.toarray(), expected)
