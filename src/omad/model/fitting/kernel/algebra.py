"""Compiled small-matrix algebra for kernels that solve many little problems: no allocation, no array expressions.

Vectors (3,) and matrices (3, 3) unless said otherwise, float64; results go into the last argument.
"""

import math

import numpy as np

from omad.common.compiled import INNER, compiled, inner


@compiled(fastmath={"reassoc", "contract"}, **INNER)
def dot(a, b):
    """Sum of products of vectors (n,), in whatever order is quickest."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


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


@inner
def invert(A, L, unit, column, out):
    """Inverse of a symmetric A (n, n), given by its lower triangle, for a covariance: very large where a direction is
    not observed; False, and ``out`` arbitrary, where A is broken. L (n, n), unit and column (n,) are worked in."""
    n = len(A)
    for i in range(n):
        if not A[i, i] >= 0.0:
            return False
        unit[i] = math.sqrt(A[i, i] if A[i, i] > 0.0 else 1e-12)
    # Scaled to a unit diagonal, whatever the units, a singular matrix needs only this much to be invertible.
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j] / (unit[i] * unit[j]) - dot(L[i, :j], L[j, :j])
            if i > j:
                L[i, j] = total / L[j, j]
            elif total + 1e-12 > 0.0:
                L[i, i] = math.sqrt(total + 1e-12)
            else:
                return False
    for j in range(n):
        column[:j] = 0.0
        for i in range(j, n):
            column[i] = ((1.0 if i == j else 0.0) - dot(L[i, j:i], column[j:i])) / L[i, i]
        for i in range(n - 1, -1, -1):
            column[i] /= L[i, i]
            for k in range(i):
                column[k] -= L[i, k] * column[i]
            out[i, j] = column[i] / (unit[i] * unit[j])
    return True


@inner
def fit_rotation(moment, out):
    """The rotation nearest to ``moment`` = sum of b a^T, which brings points a nearest to points b; the identity where
    that is 0.

    Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987. The matrix whose first
    eigenvector is the quaternion is made positive and squared until nothing else is left of it.
    """
    K, squared = np.empty((4, 4)), np.empty((4, 4))
    trace, size = moment[0, 0] + moment[1, 1] + moment[2, 2], 0.0
    K[0, 0] = trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        K[0, i + 1] = moment[k, j] - moment[j, k]
        K[i + 1, 0] = K[0, i + 1]
        for n in range(3):
            K[i + 1, n + 1] = moment[i, n] + moment[n, i]
            size += moment[i, n] ** 2
        K[i + 1, i + 1] -= trace
    if size == 0.0:  # of a single point, say, which tells nothing
        for i in range(3):
            for n in range(3):
                out[i, n] = 1.0 if i == n else 0.0
        return
    shift = 2.0 * math.sqrt(size)  # no eigenvalue is below minus the sum of the three singular values
    for i in range(4):
        K[i, i] += shift
    for _ in range(14):
        total = K[0, 0] + K[1, 1] + K[2, 2] + K[3, 3]
        for i in range(4):
            for n in range(4):
                squared[i, n] = 0.0
                for m in range(4):
                    squared[i, n] += K[i, m] * K[m, n] / (total * total)
        K, squared = squared, K
    best = 0
    for i in range(1, 4):
        if K[i, i] > K[best, best]:
            best = i
    w, x, y, z = K[best, 0], K[best, 1], K[best, 2], K[best, 3]
    double = 2.0 / (w * w + x * x + y * y + z * z)
    out[0, 0], out[0, 1], out[0, 2] = 1 - double * (y * y + z * z), double * (x * y - w * z), double * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = double * (x * y + w * z), 1 - double * (x * x + z * z), double * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = double * (x * z - w * y), double * (y * z + w * x), 1 - double * (x * x + y * y)
