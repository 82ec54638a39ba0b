"""Cheapest ways through a graph from one of several roots, whose arcs may cost something else every time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
        column: node that every step leads to, then every arc of every root, row by row.
        row: where every row begins in `column`, of the nodes, then of the roots, and where the last one ends.
        arcs: of every root, in which order its arcs lie in its row, (k,) each.
    """

    column: NDArray[np.int32]
    row: NDArray[np.int32]
    arcs: tuple[Index, ...]

    @staticmethod
    def of(column: NDArray[np.int32], roots: Sequence[Index]) -> RootedGraph:
        """Lay out the graph.

        Args:
            column: node that every step leads to, (n, steps).
            roots: node that every arc of every root leads to, (k,) each.
        """
        arcs = tuple(np.argsort(ends, kind="stable") for ends in roots)
        leads = [ends[order].astype(np.int32) for ends, order in zip(roots, arcs, strict=True)]
        last = column.size + np.cumsum([len(ends) for ends in leads], dtype=np.int32)
        row = np.concatenate([np.arange(0, column.size + 1, column.shape[1], dtype=np.int32), last])
        return RootedGraph(np.concatenate([column.ravel(), *leads]), row, arcs)

    def tree(
        self, step: Array, root: int, arc: Array, limit: float = NO_LIMIT, shut: NDArray[np.bool_] | None = None
    ) -> Tree:
        """The cheapest ways from a root, as far as a limit.

        Args:
            step: cost of every step, (n, steps).
            root: which one.
            arc: cost of each of its arcs, (k,).
            limit: cost beyond which no way is followed.
            shut: nodes that no way leads on from, (n,).
        """
        nodes, size = len(step), len(self.row) - 1
        cost = np.full(len(self.column), np.inf)
        cost[: step.size] = step.ravel()
        cost[self.row[nodes + root] : self.row[nodes + root + 1]] = arc[self.arcs[root]]
        if shut is not None:
            cost[: step.size].reshape(step.shape)[shut] = np.inf
        graph = sparse.csr_matrix((cost, self.column, self.row), (size, size))
        length, before = csgraph.dijkstra(graph, indices=[nodes + root], return_predecessors=True, limit=limit)
        return Tree(length[0, :nodes], before[0, :nodes], arc)
