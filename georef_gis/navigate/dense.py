"""Small dense linear algebra for compiled code: one place, compiled once, and never raising."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from georef_gis.frames import Array

# Compiled once and kept beside the source; a division by zero gives infinity as in numpy.
compiled = njit(cache=True, error_model="numpy")


@compiled
def product(a: Array, b: Array) -> Array:
    """``a b`` of two contiguous matrices."""
    return a @ b


@compiled
def product_t(a: Array, b: Array) -> Array:
    """``a b'`` of two contiguous matrices."""
    return a @ b.T


@compiled
def cholesky(S: Array) -> Array:
    """Lower triangle L of ``S = L L'``; rows without variance are left out (1 on the diagonal)."""
    n = len(S)
    L = np.zeros((n, n))
    for j in range(n):
        d = S[j, j]
        for k in range(j):
            d -= L[j, k] * L[j, k]
        # what rounding leaves of a state without variance
        if not d > 1e-13 * S[j, j]:
            L[j, j] = 1.0
            continue
        d = math.sqrt(d)
        L[j, j] = d
        for i in range(j + 1, n):
            s = S[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s / d
    return L


@compiled
def solve_rows(L: Array, B: Array) -> None:
    """Replace each row b of B by ``(L L')^-1 b``; shapes (n, n) and (m, n)."""
    n = len(L)
    for r in range(len(B)):
        b = B[r]
        for i in range(n):
            s = b[i]
            for k in range(i):
                s -= L[i, k] * b[k]
            b[i] = s / L[i, i]
        for i in range(n - 1, -1, -1):
            s = b[i]
            for k in range(i + 1, n):
                s -= L[k, i] * b[k]
            b[i] = s / L[i, i]


@compiled
def symmetrise(P: Array) -> None:
    """Mean of a matrix and its transpose, in place."""
    for i in range(len(P)):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean


@compiled
def sample_before(table: Array, time: float) -> int:
    """Last row of a table (n, k) whose first column is at or before a time; the first at least."""
    low, high = 0, len(table)
    while high - low > 1:
        middle = (low + high) // 2
        if table[middle, 0] <= time:
            low = middle
        else:
            high = middle
    return low
