# SPDX-License-Identifier: GPL-3.0-or-later
"""Signs spread along a minimum spanning tree of a graph whose edges carry signs."""

import numpy as np

from ..inputs import FloatArray, IntArray


def spread_signs(
    count: int, edges: IntArray, weight: FloatArray, sign: IntArray, root: int = 0
) -> tuple[IntArray, IntArray]:
    """Label the nodes of a signed graph along its minimum spanning tree.

    Parameters
    ----------
    count : int
        Number of nodes.
    edges : (e, 2) int
    weight : (e,) float, at least 0
        How doubtful each edge is.
    sign : (e,) int8
        +1 where both ends have the same label, -1 where they have opposite ones.
    root : int
        A node labelled +1. Every part of the graph without it has a root of its own,
        its first node.

    Returns
    -------
    label : (count,) int8, +1 or -1
    part : (count,) int
        The connected part of each node.

    Notes
    -----
    Every node first knows its sign relative to its parent; jumping from parent to
    grandparent and on, it knows it relative to the root after log2(depth) rounds.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    if not len(edges):
        return np.ones(count, dtype=np.int8), np.arange(count)
    key, weight, sign = _lightest(count, edges, weight, sign)
    # A stored zero would be no edge at all to scipy.
    graph = sparse.coo_matrix(
        (weight + 1e-12, (key // count, key % count)), shape=(count, count)
    )
    tree = minimum_spanning_tree(graph.tocsr())
    parts, part = connected_components(tree, directed=False)
    roots = np.unique(part, return_index=True)[1]
    roots[part[root]] = root
    parent = _parents(tree, roots, parts)
    here = np.arange(count)
    at = np.searchsorted(
        key, np.minimum(here, parent) * count + np.maximum(here, parent)
    )
    label = np.where(parent == here, 1, sign[np.minimum(at, len(key) - 1)])
    label = label.astype(np.int8)
    while True:
        further = parent[parent]
        if (further == parent).all():
            return label, part
        label *= np.where(parent == here, 1, label[parent]).astype(np.int8)
        parent = further


def _lightest(count, edges, weight, sign):
    """Keep the lightest of the edges between two nodes, sorted by a key."""
    low, high = edges.min(axis=1).astype(np.int64), edges.max(axis=1)
    key = low * count + high
    order = np.argsort(key)
    key = key[order]
    again = key[1:] == key[:-1]
    if again.any():
        # Few edges have a twin: only these are sorted by weight too.
        twin = np.append(False, again) | np.append(again, False)
        rows = order[twin]
        order[twin] = rows[np.lexsort((sign[rows], weight[rows], key[twin]))]
        first = np.append(True, ~again)
        key, order = key[first], order[first]
    return key, weight[order], sign[order]


def _parents(tree, roots, parts):
    """Return each node's parent in a forest; the roots are their own."""
    from scipy import sparse
    from scipy.sparse.csgraph import breadth_first_order

    n = tree.shape[0]
    # One tree of all: a node beside the others, joined to every root.
    joined = sparse.bmat(
        [
            [tree, None],
            [
                sparse.coo_matrix(
                    (np.ones(parts), (np.zeros(parts, dtype=int), roots)), shape=(1, n)
                ),
                sparse.coo_matrix((1, 1)),
            ],
        ]
    ).tocsr()
    _, parent = breadth_first_order(joined, n, directed=False, return_predecessors=True)
    parent = parent[:n].astype(np.int64)
    parent[roots] = roots
    return parent
