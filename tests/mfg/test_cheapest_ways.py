"""Searches from the roots of one graph: each is as on a graph of its own, and leaves all as it was."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import csgraph

from mfg.cheapest_ways import RootedGraph


@pytest.mark.parametrize("seed", range(12))
def test_a_search_is_as_on_a_graph_of_its_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, steps = int(rng.integers(4, 40)), int(rng.integers(1, 5))
    column = rng.integers(0, n, (n, steps)).astype(np.int32)
    step = rng.uniform(0.1, 2.0, (n, steps))
    roots = [rng.choice(n, int(rng.integers(1, n)), replace=False) for _ in range(3)]
    graph = RootedGraph.of(column, rng.uniform(0.1, 2.0, (n, steps)), roots).costing(step)
    before = graph.matrix.data.copy()
    for _ in range(8):
        root = int(rng.integers(3))
        arc, shut = rng.uniform(0.1, 3.0, len(roots[root])), rng.random(n) < 0.3
        limit = float(rng.choice([1.5, 1e9]))
        tree = graph.tree(root, arc, limit, shut)
        dense = np.full((n + 1, n + 1), np.inf)
        for a in np.flatnonzero(~shut):
            for b, cost in zip(column[a], step[a], strict=True):
                dense[a, b] = min(dense[a, b], cost)
        dense[n, roots[root]] = arc
        expected = csgraph.dijkstra(csgraph.csgraph_from_dense(dense, null_value=np.inf), indices=n, limit=limit)[:n]
        np.testing.assert_allclose(tree.length, expected)
        np.testing.assert_array_equal(graph.matrix.data, before)
        for node in np.flatnonzero(np.isfinite(tree.length)):
            back = tree.before[node]
            assert back >= n or tree.length[back] < tree.length[node] or back == node


def test_other_costs_leave_the_first_graph_alone() -> None:
    column = np.array([[1], [0]], np.int32)
    first = RootedGraph.of(column, np.ones((2, 1)), [np.array([0])])
    second = first.costing(np.full((2, 1), 5.0))
    assert first.tree(0, np.zeros(1)).length.tolist() == [0.0, 1.0]
    assert second.tree(0, np.zeros(1)).length.tolist() == [0.0, 5.0]
    assert isinstance(first.matrix, sparse.csr_matrix)
