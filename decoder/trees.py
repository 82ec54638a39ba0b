"""The trees that synthetic bodies grow on: a torso with one to five limbs, each a chain or a fork, mirrored or not."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from decoder.parts import MAX_PARTS

MAX_LIMBS = 5
_SEGMENT_ODDS = {3: 0.13, 4: 0.17, 5: 0.21, 6: 0.20, 7: 0.17, 8: 0.12}
_LIMB_ODDS = {1: 0.10, 2: 0.20, 3: 0.26, 4: 0.30, 5: 0.14}
_SYMMETRIC = 0.5  # share of mirrored bodies where the number of segments allows both
_FORKED = 0.8  # how often a tree with a fork is drawn, relative to one without


@dataclass(frozen=True)
class Limb:
    """Shape of one limb: `parents[i]` is the part before part i (-1: the torso), `sides[i]` the branch of a fork it
    is on (+1, -1, or 0 for none), `twins[i]` the part it mirrors if the limb itself lies in the mirror plane.
    """

    parents: tuple[int, ...]
    sides: tuple[int, ...]
    twins: tuple[int, ...]

    @property
    def planar(self) -> bool:
        """Whether the limb can be its own mirror image."""
        return all(side <= 0 or i in self.twins for i, side in enumerate(self.sides))


LIMBS = (
    Limb((-1,), (0,), (-1,)),
    Limb((-1, 0), (0, 0), (-1, -1)),
    Limb((-1, 0, 1), (0, 0, 0), (-1, -1, -1)),
    Limb((-1, 0, 0), (0, 1, -1), (-1, -1, 1)),
    Limb((-1, 0, 1, 2), (0, 0, 0, 0), (-1, -1, -1, -1)),
    Limb((-1, 0, 1, 1), (0, 0, 1, -1), (-1, -1, -1, 2)),
    Limb((-1, 0, 0, 1), (0, 1, -1, 0), (-1, -1, -1, -1)),
    Limb((-1, 0, 0, 1, 2), (0, 1, -1, 0, 0), (-1, -1, 1, -1, 3)),
)


@dataclass(frozen=True, eq=False)
class Trees:
    """Every tree, one per row; part 0 is the torso, parents come before children, unused parts have parent -1.

    Attributes:
        odds: how often each is drawn, (t,), sum 1.
        parent: (t, 8); -1 for the torso and for unused parts.
        count: parts in use, (t,).
        azimuth: angle about z at which a limb leaves the torso [rad], (t, 8); 0 beyond the first part.
        sway: how far that angle may wander either way [rad], (t, 8).
        side: branch of a fork, (t, 8).
        twin: part of which this one is the mirror image in y, or -1, (t, 8).
        planar: whether the part lies in the mirror plane, (t, 8).
        symmetric: whether left mirrors right, (t,).
    """

    odds: NDArray[np.float64]
    parent: NDArray[np.int64]
    count: NDArray[np.int64]
    azimuth: NDArray[np.float64]
    sway: NDArray[np.float64]
    side: NDArray[np.int64]
    twin: NDArray[np.int64]
    planar: NDArray[np.bool_]
    symmetric: NDArray[np.bool_]


@lru_cache(maxsize=1)
def all_trees() -> Trees:
    """List every tree of 3 to 8 segments with one to five limbs, in a fixed order."""
    rows, groups = [], []
    for limbs in range(1, MAX_LIMBS + 1):
        for shapes in itertools.product(LIMBS, repeat=limbs):
            count = 1 + sum(len(shape.parents) for shape in shapes)
            if not 3 <= count <= MAX_PARTS:
                continue
            if max(len(set(shape.parents)) for shape in shapes) > 3 and limbs > 2:
                continue  # Chains of four parts only in snake-like bodies; others would not fit the grid.
            for symmetric, start, twins in _mirrors(shapes):
                rows.append(_row(shapes, start, twins, symmetric))
                forked = any(any(shape.sides) for shape in shapes)
                groups.append((count, limbs, symmetric, forked))
    odds = np.array([_weight(group, groups) for group in sorted(set(groups))])
    table = dict(zip(sorted(set(groups)), odds.tolist(), strict=True))
    weights = np.array([table[group] for group in groups])
    fields = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Trees(odds=weights / weights.sum(), **fields)


def _weight(group: tuple[int, int, bool, bool], groups: list[tuple[int, int, bool, bool]]) -> float:
    """Odds of one tree of a group: those of its traits, shared among the trees that have them."""
    count, limbs, symmetric, forked = group
    siblings = {g for g in groups if g[0] == count}
    share = _LIMB_ODDS[limbs] * (_SYMMETRIC if symmetric else 1 - _SYMMETRIC) * (_FORKED if forked else 1.0)
    total = sum(_LIMB_ODDS[g[1]] * (_SYMMETRIC if g[2] else 1 - _SYMMETRIC) * (_FORKED if g[3] else 1.0)
                for g in siblings)  # fmt: skip
    return _SEGMENT_ODDS[count] * share / total / groups.count(group)


def _mirrors(shapes: tuple[Limb, ...]) -> list[tuple[bool, float, list[int]]]:
    """Ways to place the limbs: symmetric or not, angle of the first, and whose mirror image each one is."""
    count = len(shapes)
    turn = 2 * math.pi / count
    found: list[tuple[bool, float, list[int]]] = [(False, 0.0, [-1] * count)]
    if count % 2 == 0:
        pairs = [count - 1 - k for k in range(count)]
        if all(shapes[k] == shapes[pairs[k]] for k in range(count)):
            found.append((True, turn / 2, [p if p < k else -1 for k, p in enumerate(pairs)]))
    pairs = [-k % count for k in range(count)]
    if count > 1 and all(shapes[k] == shapes[p] and (k != p or shapes[k].planar) for k, p in enumerate(pairs)):
        for start in (0.0, math.pi) if count % 2 else (0.0,):
            found.append((True, start, [p if p < k else -1 if p > k else k for k, p in enumerate(pairs)]))
    return found


def _row(shapes: tuple[Limb, ...], start: float, twins: list[int], symmetric: bool) -> dict[str, object]:
    """One tree: `twins[k]` is the limb that limb k mirrors, k itself if it lies in the mirror plane, or -1."""
    turn = 2 * math.pi / len(shapes)
    first = 1 + np.concatenate([[0], np.cumsum([len(shape.parents) for shape in shapes])])
    parent, side, twin = (np.full(MAX_PARTS, value) for value in (-1, 0, -1))
    azimuth, sway = np.zeros(MAX_PARTS), np.zeros(MAX_PARTS)
    planar = np.zeros(MAX_PARTS, bool)
    planar[0] = symmetric
    for k, shape in enumerate(shapes):
        for i, before in enumerate(shape.parents):
            part = first[k] + i
            parent[part] = 0 if before < 0 else first[k] + before
            side[part] = shape.sides[i]
            if before < 0:
                azimuth[part] = start + turn * k
                sway[part] = 0.0 if twins[k] == k else 0.25 * turn
            if twins[k] == k:
                twin[part] = first[k] + shape.twins[i] if shape.twins[i] >= 0 else -1
                planar[part] = shape.sides[i] == 0 and (before < 0 or bool(planar[first[k] + before]))
            elif twins[k] >= 0:
                twin[part] = first[twins[k]] + i
    return {"parent": parent, "count": int(first[-1]), "azimuth": azimuth, "sway": sway, "side": side, "twin": twin,
            "planar": planar, "symmetric": symmetric}  # fmt: skip
