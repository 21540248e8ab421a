"""Small dense linear algebra for compiled code: one place, compiled once, and never raising."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

from georef_gis.frames import Array

F = TypeVar("F", bound=Callable[..., object])
# a division by zero gives infinity as in numpy; no entry for callers in C, of which there are none
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: F) -> F:
    """A function compiled at its first call, kept beside its source for later runs."""
    return cast(F, njit(cache=True, **_OPTIONS)(function))


# The first run on a machine waits for the compiler, whose time goes with the kinds of expression
# it meets, not with the work they do: an array assigned to a slice costs it 2 s, a product by BLAS
# 0.5 s, a reshape, an identity or a sum of arrays 0.2 s each, a loop 0.01 s. Hence the loops here
# and in what builds on it.


@compiled
def copy_row(row: Array, out: Array) -> None:
    """Numbers of a vector into another of its length."""
    for i in range(len(out)):
        out[i] = row[i]


@compiled
def copy_matrix(a: Array, out: Array) -> None:
    """Numbers of a matrix into another of its shape."""
    for i in range(len(out)):
        copy_row(a[i], out[i])


@compiled
def transposed(a: Array) -> Array:
    """``a'`` as a contiguous matrix."""
    n, m = a.shape
    out = np.empty((m, n))
    for i in range(n):
        for j in range(m):
            out[j, i] = a[i, j]
    return out


@compiled
def product(a: Array, b: Array) -> Array:
    """``a b`` of two matrices; zeros of `a` cost nothing."""
    m = b.shape[1]
    out = np.zeros((len(a), m))
    for i in range(len(a)):
        for k in range(len(b)):
            factor = a[i, k]
            # most of a transition is zero
            if factor != 0.0:
                for j in range(m):
                    out[i, j] += factor * b[k, j]
    return out


@compiled
def product_t(a: Array, b: Array) -> Array:
    """``a b'`` of two matrices."""
    return product(a, transposed(b))


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
def solve_columns(L: Array, B: Array) -> None:
    """Replace each column b of B by ``(L L')^-1 b``; shapes (n, n) and (n, m).

    All columns at a time: the processor works along the rows of B.
    """
    n, m = B.shape
    for i in range(n):
        for k in range(i):
            factor = L[i, k]
            for j in range(m):
                B[i, j] -= factor * B[k, j]
        for j in range(m):
            B[i, j] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            factor = L[k, i]
            for j in range(m):
                B[i, j] -= factor * B[k, j]
        for j in range(m):
            B[i, j] /= L[i, i]


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


@compiled
def pack(P: Array, out: Array) -> None:
    """Lower triangle by rows, into `out` (n (n + 1) / 2,)."""
    k = 0
    for i in range(len(P)):
        for j in range(i + 1):
            out[k] = P[i, j]
            k += 1


@compiled
def unpack(packed: Array, n: int) -> Array:
    """Matrix of a packed lower triangle, (n, n)."""
    P = np.empty((n, n))
    k = 0
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = packed[k]
            P[j, i] = packed[k]
            k += 1
    return P
