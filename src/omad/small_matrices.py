"""Compiled small-matrix algebra for kernels that solve many little problems: no allocation, no array expressions.

Vectors (3,) and matrices (3, 3) unless said otherwise, float64; results go into the last argument.
"""

from __future__ import annotations

import math
from typing import Any

import numba

# Only called from compiled code: no wrappers for Python and C to compile.
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
jit = numba.njit(cache=True, error_model="numpy", nogil=True)
inner = numba.njit(cache=True, error_model="numpy", nogil=True, **INNER)


@inner
def rotation(v, s, k, out):
    """``I + s [v]x + k [v]x^2`` into out (3, 3)."""
    squared = v[0] ** 2 + v[1] ** 2 + v[2] ** 2
    for i in range(3):
        for n in range(3):
            out[i, n] = k * v[i] * v[n]
        out[i, i] += 1.0 - k * squared
    add_skew(s, v, out)


@inner
def add_skew(s, v, matrix):
    """``matrix += s [v]x`` in the first three columns of ``matrix`` (3, n)."""
    matrix[0, 1] -= s * v[2]
    matrix[0, 2] += s * v[1]
    matrix[1, 0] += s * v[2]
    matrix[1, 2] -= s * v[0]
    matrix[2, 0] -= s * v[1]
    matrix[2, 1] += s * v[0]


@inner
def cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inner
def times(matrix, v, out):
    """Rows of ``matrix`` (3, 3) times ``v``, into ``out``."""
    for i in range(3):
        out[i] = matrix[i, 0] * v[0] + matrix[i, 1] * v[1] + matrix[i, 2] * v[2]


@inner
def solve_damped(A, extra, g, L, step):
    """step = -(A + diag extra)^-1 g by Cholesky; False where that is not positive definite."""
    n = len(g)
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            if i == j:
                total += extra[i]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    for i in range(n):
        total = -g[i]
        for k in range(i):
            total -= L[i, k] * step[k]
        step[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= L[k, i] * step[k]
        step[i] = total / L[i, i]
    return True
