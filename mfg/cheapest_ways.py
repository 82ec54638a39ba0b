"""Cheapest ways through a graph from one of several roots, whose arcs may cost something else every time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

Array = NDArray[np.float64]
Index = NDArray[np.int64]
NO_LIMIT = 1e9  # longer than any way


@dataclass(frozen=True, eq=False, slots=True)
class Tree:
    """Cheapest ways from one root.

    Attributes:
        length: cost of the way to every node, infinite where there is none within the limit, (n,).
        before: the node before every node; n or more after an arc, negative where there is no way, (n,).
        cost: of every arc at the root, as it was counted, (k,).
    """

    length: Array
    before: NDArray[np.int32]
    cost: Array


@dataclass(frozen=True, eq=False, slots=True)
class RootedGraph:
    """Nodes with as many steps each, and roots that lead to some of them and that no step leads to: laid out once.

    Attributes:
        steps: from every node.
        matrix: cost of every step of every node, row by row, then of every arc of every root; arcs are shut between
            searches, and a search leaves all as it was.
        arcs: of every root, in which order its arcs lie in its row, (k,) each.
    """

    steps: int
    matrix: sparse.csr_matrix
    arcs: tuple[Index, ...]

    @staticmethod
    def of(column: NDArray[np.int32], step: NDArray[np.floating], roots: Sequence[Index]) -> RootedGraph:
        """Lay out the graph.

        Args:
            column: node that every step leads to, (n, steps).
            step: what it costs, (n, steps).
            roots: node that every arc of every root leads to, (k,) each.
        """
        arcs = tuple(np.argsort(ends, kind="stable") for ends in roots)
        leads = [ends[order].astype(np.int32) for ends, order in zip(roots, arcs, strict=True)]
        last = column.size + np.cumsum([len(ends) for ends in leads], dtype=np.int32)
        row = np.concatenate([np.arange(0, column.size + 1, column.shape[1], dtype=np.int32), last])
        size = len(row) - 1
        cost = np.concatenate([step.ravel(), np.full(row[-1] - step.size, np.inf)], dtype=np.float64)
        matrix = sparse.csr_matrix((cost, np.concatenate([column.ravel(), *leads]), row), (size, size))
        return RootedGraph(column.shape[1], matrix, arcs)

    def costing(self, step: NDArray[np.floating]) -> RootedGraph:
        """The same graph with other costs of the steps, (n, steps)."""
        cost = np.concatenate([step.ravel(), self.matrix.data[step.size :]], dtype=np.float64)
        matrix = sparse.csr_matrix((cost, self.matrix.indices, self.matrix.indptr), self.matrix.shape)
        return replace(self, matrix=matrix)

    def tree(self, root: int, arc: Array, limit: float = NO_LIMIT, shut: NDArray[np.bool_] | None = None) -> Tree:
        """The cheapest ways from a root, as far as a limit.

        Args:
            root: which one.
            arc: cost of each of its arcs, (k,).
            limit: cost beyond which no way is followed.
            shut: nodes that no way leads on from, (n,).
        """
        row, cost = self.matrix.indptr, self.matrix.data
        nodes = len(row) - 1 - len(self.arcs)
        onward = cost[: nodes * self.steps].reshape(nodes, self.steps)
        closed = np.zeros(0, np.int64) if shut is None else np.flatnonzero(shut)
        before, own = onward[closed], slice(row[nodes + root], row[nodes + root + 1])
        onward[closed], cost[own] = np.inf, arc[self.arcs[root]]
        try:
            length, back = csgraph.dijkstra(self.matrix, indices=[nodes + root], return_predecessors=True, limit=limit)
        finally:
            onward[closed], cost[own] = before, np.inf
        return Tree(length[0, :nodes], back[0, :nodes], arc)
