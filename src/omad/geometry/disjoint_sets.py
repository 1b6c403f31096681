"""Disjoint sets as forests in an array, for compiled loops: ``root[i]`` leads from a member towards its set's first."""

import numpy as np

from omad.common.compiled import inner


@inner
def first_of(root, i):
    """The first member of the set that ``i`` is in; the way to it gets shorter."""
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@inner
def join(root, i, j):
    """Make one of the sets of ``i`` and ``j``."""
    a, b = first_of(root, i), first_of(root, j)
    root[max(a, b)] = min(a, b)


@inner
def numbered(root):
    """(N,) number of each member's set, in the order of their first members."""
    labels, sets = np.empty_like(root), 0
    for i in range(len(root)):
        first = first_of(root, i)
        if first == i:
            labels[i] = sets
            sets += 1
        else:
            labels[i] = labels[first]
    return labels
