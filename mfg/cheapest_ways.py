"""Cheapest ways through a graph from one of several roots, whose arcs may cost something else every time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

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
    """Nodes with as many steps each, laid out once, and roots that lead to some of them and that no step leads to.

    Attributes:
        steps: cost of every step, a row for every node and then one for every root, (n + roots, n + roots).
        arcs: of every root, in which order its arcs lie in its row, (k,) each.
        shape: nodes, and steps of each.
    """

    steps: sparse.csr_matrix
    arcs: tuple[Index, ...]
    shape: tuple[int, int]

    @staticmethod
    def of(column: NDArray[np.int32], cost: Array, roots: Sequence[Index]) -> RootedGraph:
        """Lay out the graph.

        Args:
            column: node that every step leads to, (n, steps).
            cost: of every step, (n, steps).
            roots: node that every arc of every root leads to, (k,) each.
        """
        arcs = tuple(np.argsort(ends, kind="stable") for ends in roots)
        first = cost.size + np.cumsum([0, *(len(order) for order in arcs)])
        steps = sparse.csr_matrix(
            (
                np.concatenate([cost.ravel(), np.full(int(first[-1]) - cost.size, np.inf)]),
                np.concatenate([column.ravel(), *(ends[order] for ends, order in zip(roots, arcs, strict=True))]),
                np.concatenate([np.arange(0, cost.size, cost.shape[1]), first]),
            ),
            shape=(len(cost) + len(roots), len(cost) + len(roots)),
        )
        return RootedGraph(steps, arcs, (cost.shape[0], cost.shape[1]))

    def tree(self, root: int, cost: Array, limit: float = NO_LIMIT, shut: NDArray[np.bool_] | None = None) -> Tree:
        """The cheapest ways from a root, as far as a limit.

        Args:
            root: which one.
            cost: of its arcs, (k,).
            limit: cost beyond which no way is followed.
            shut: nodes that no way leads on from, (n,).
        """
        nodes, steps = self.shape
        data = self.steps.data.copy()
        low, high = list(pairwise(self.steps.indptr[nodes:].tolist()))[root]
        data[low:high] = cost[self.arcs[root]]
        if shut is not None:
            data[: nodes * steps].reshape(nodes, steps)[shut] = np.inf
        graph = sparse.csr_matrix((data, self.steps.indices, self.steps.indptr), self.steps.shape)
        length, before = csgraph.dijkstra(graph, indices=nodes + root, return_predecessors=True, limit=limit)
        return Tree(length[:nodes], before[:nodes], cost)
