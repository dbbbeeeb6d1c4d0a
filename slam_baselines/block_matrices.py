"""Sparse matrices of 3x3 blocks, one for each pose of a graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def sum_blocks(blocks: Array, index: Indices, n: int) -> Array:
    """Return (n, 3, 3) the sums of the (k, 3, 3) blocks of each index."""
    return sum_vectors(blocks.reshape(-1, 9), index, n).reshape(n, 3, 3)


def sum_vectors(vectors: Array, index: Indices, n: int) -> Array:
    """Return (n, k) the sums of the vectors of each index."""
    columns = [np.bincount(index, weights=column, minlength=n) for column in vectors.T]
    return np.stack(columns, axis=-1)


def block_matrix(blocks: Array, rows: Indices, cols: Indices, n: int, m: int) -> sparse.csr_matrix:
    """Return the sparse matrix of (k, 3, 3) blocks at block rows and columns; equal places add up."""
    three = np.arange(3)
    r = np.broadcast_to((3 * rows)[:, None, None] + three[:, None], blocks.shape)
    c = np.broadcast_to((3 * cols)[:, None, None] + three, blocks.shape)
    return sparse.coo_matrix((blocks.ravel(), (r.ravel(), c.ravel())), shape=(3 * n, 3 * m)).tocsr()
