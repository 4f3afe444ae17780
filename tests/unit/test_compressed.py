"""Compressed matrices give what SciPy's operations give."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from tominpmp.linear_programs.compressed import Compressed, sorted_in


@pytest.fixture
def matrix() -> sp.csr_matrix:
    """Some rows and columns of it are empty."""
    dense = np.random.default_rng(0).normal(size=(9, 7))
    dense[np.abs(dense) < 0.6] = 0.0
    dense[[0, 4, 8]] = dense[:, [2, 6]] = 0.0
    return sp.csr_matrix(dense)


@pytest.mark.parametrize("kind", ["csr", "csc"])
def test_some_places_of_some_lines(matrix: sp.csr_matrix, kind: str) -> None:
    rng = np.random.default_rng(1)
    dense, own = matrix.toarray(), Compressed.of(matrix.asformat(kind))
    rows, columns = rng.random(9) < 0.6, rng.random(7) < 0.6
    if kind == "csr":
        found = own.chosen(columns, rows).rows()
        alone = own.chosen(lines=rows).rows(), own.chosen(columns).rows()
    else:
        found = own.chosen(rows, columns).columns()
        alone = own.chosen(rows).columns(), own.chosen(lines=columns).columns()
    found.check_format(full_check=True)
    np.testing.assert_array_equal(found.toarray(), dense[rows][:, columns])
    np.testing.assert_array_equal(alone[0].toarray(), dense[rows])
    np.testing.assert_array_equal(alone[1].toarray(), dense[:, columns])
    assert own.chosen() is own


def test_lines_behind_others(matrix: sp.csr_matrix) -> None:
    own = Compressed.of(matrix)
    other = Compressed.of_table(np.array([[2.0], [-1.0]]), np.array([[3], [0]]), 7)
    found = own.followed_by(other, own).rows()
    found.check_format(full_check=True)
    ones = sp.csr_matrix(([2.0, -1.0], ([0, 1], [3, 0])), shape=(2, 7))
    expected = sp.vstack([matrix, ones, matrix])
    np.testing.assert_array_equal(found.toarray(), expected.toarray())


def test_entries_of_a_table_that_are_somewhere_and_not_zero() -> None:
    data = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0], [3.0, 4.0, 5.0]])
    places = np.array([[0, 2, 3], [0, 1, 2], [-1, 1, 3]])
    found = Compressed.of_table(data, places, 4).rows()
    assert found.nnz == 4
    expected = [[1.0, 0.0, 2.0, 0.0], [0.0] * 4, [0.0, 4.0, 0.0, 5.0]]
    np.testing.assert_array_equal(found.toarray(), expected)


def test_sums_largest_entries_and_factors(matrix: sp.csr_matrix) -> None:
    own, most = Compressed.of(matrix), np.linspace(0.1, 2.0, 7)
    sizes = np.abs(matrix.toarray())
    np.testing.assert_allclose(own.reach(most), sizes @ most, rtol=1e-15)
    np.testing.assert_array_equal(own.largest(), sizes.max(axis=0))
    scaled = own.times(most).rows().toarray()
    np.testing.assert_array_equal(scaled, matrix.toarray() * most)


def test_entries_are_sorted_into_their_lines() -> None:
    lines, places = np.array([2, 0, 2, 0]), np.array([0, 1, 3, 4])
    found = sorted_in(lines, places, np.array([1.0, 2.0, 3.0, 4.0]), 3, 5).columns()
    expected = np.zeros((5, 3))
    expected[places, lines] = [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_array_equal(found.toarray(), expected)
    found.check_format(full_check=True)
