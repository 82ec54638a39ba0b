"""Choose one candidate seat per joint, all joints together, so that no two motors meet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mfg.mounts import Mount

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Stuck:
    """No choice exists, or none was found within the allowed steps.

    Attributes:
        joint: that had no acceptable candidate left when the search had got furthest.
        other: the joint whose seat stood in its way, or None where none of its own candidates is acceptable.
    """

    joint: int
    other: int | None


@dataclass(frozen=True, eq=False, slots=True)
class Clearance:
    """What is known about the envelopes of m motors and those of n others.

    Attributes:
        distance: clear distance between them, at most the true one; negative where they may meet [m], (m, n).
        meet: whether they certainly share a point, (m, n).
    """

    distance: Array
    meet: Mask

    @staticmethod
    def of(T: Array, U: Array, mount: Mount) -> Clearance:
        """Compare motors at poses T (m, 4, 4) with motors at poses U (n, 4, 4).

        The envelopes are taken as plain cylinders. Apart is what casts shadows that are apart on the two axes, on their
        common normal, or on the lines between their middles and between their nearest axis points; the widest gap is
        the distance. Together is what holds one of some points on these two lines.
        """
        low, high = mount.base_low, mount.connector_high
        half, radius = (high - low) / 2, mount.envelope_radius
        middle = (low + high) / 2
        # Components come first, (3, m, n): numpy multiplies many short vectors slowly.
        z, w = T[:, :3, 2].T[:, :, None], U[:, :3, 2].T[:, None]
        between = (U[:, :3, 3].T[:, None] + middle * w) - (T[:, :3, 3].T[:, :, None] + middle * z)
        cosine, ahead, back = _dot(z, w), _dot(between, z), _dot(between, w)
        # The nearest points of two segments, by alternating projection: near enough to propose a direction.
        s: Array = np.zeros(cosine.shape)
        for _ in range(3):
            t = np.clip(s * cosine - back, -half, half)
            s = np.clip(t * cosine + ahead, -half, half)
        shortest = between + t * w - s * z
        # What a direction n shows: |n z|, |n w| and |n (middle to middle)|, in the order in which they are named above.
        long, short = np.sqrt(_dot(between, between)), np.sqrt(_dot(shortest, shortest))
        normal = np.stack([z[1] * w[2] - z[2] * w[1], z[2] * w[0] - z[0] * w[2], z[0] * w[1] - z[1] * w[0]])
        sine = np.sqrt(_dot(normal, normal))  # of 1 - cosine^2 nothing true is left where axes are nearly parallel
        on_z = np.stack([np.ones_like(cosine), cosine, np.zeros_like(cosine), ahead / np.maximum(long, 1e-12),
                         _dot(shortest, z) / np.maximum(short, 1e-12)])  # fmt: skip
        on_w = np.stack([cosine, on_z[0], on_z[2], back / np.maximum(long, 1e-12),
                         _dot(shortest, w) / np.maximum(short, 1e-12)])  # fmt: skip
        apart = np.stack([ahead, back, _dot(normal, between) / np.maximum(sine, 1e-12), long,
                          _dot(shortest, between) / np.maximum(short, 1e-12)])  # fmt: skip
        gap = np.abs(apart)
        for on in (np.abs(on_z), np.abs(on_w)):
            gap -= half * on + radius * np.sqrt(np.maximum(1 - on * on, 0.0))
        for way, length in ((2, sine), (3, long), (4, short)):
            gap[way][length <= 1e-9] = -np.inf
        slim = min(mount.holder_radius, mount.connector_radius)
        near = s * z
        meet: Mask = np.zeros(cosine.shape, bool)
        for point in (0.5 * between, near + 0.3 * shortest, near + 0.5 * shortest, near + 0.7 * shortest):
            both: Mask = np.ones(cosine.shape, bool)
            for axis, from_it in ((z, point), (w, point - between)):
                along = _dot(from_it, axis)
                both &= (np.abs(along) < half) & (_dot(from_it, from_it) - along * along < slim**2)
            meet |= both
        return Clearance(gap.max(axis=0), meet)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], np.float64)


def choose(
    scores: Sequence[Array],
    possible: Callable[[int, int, int], Mask],
    clear: Callable[[int, int, int, int], bool],
    accept: Callable[[int, int], bool],
    steps: int,
) -> list[int] | Stuck:
    """The candidates, one per joint, with the greatest sum of scores among those that get along (branch and bound).

    The optimum if no more than `steps` candidates are tried on the way, else the best choice found until then.

    Args:
        scores: of every joint's candidates, best first, (k,) each.
        possible: False for those candidates of joint j that certainly meet candidate a of joint i: (i, a, j), i < j.
        clear: whether candidate a of joint i and b of joint j keep apart: (i, a, j, b), i < j; asked for the rest only.
        accept: whether a candidate is good by itself: (joint, candidate); asked for whole choices only.
        steps: most candidates to try.
    """
    search = _Search(list(scores), possible, clear, accept, steps)
    search.descend([], [np.ones(len(s), bool) for s in scores])
    if search.best is not None:
        return search.best
    hopeless = [i for i, s in enumerate(scores) if (~search.open[i]).sum() == len(s)]
    return Stuck(hopeless[0], None) if hopeless else search.stuck


class _Search:
    """The state of one branch and bound; joints in their own order, so that parents come before children."""

    def __init__(
        self,
        scores: list[Array],
        possible: Callable[[int, int, int], Mask],
        clear: Callable[[int, int, int, int], bool],
        accept: Callable[[int, int], bool],
        steps: int,
    ) -> None:
        self.scores, self.steps = scores, steps
        self._possible, self._accept = possible, cache(accept)
        self._clear = cache(clear)
        self.open = [np.ones(len(s), bool) for s in scores]  # False once refused
        self.refusals = 0
        self.best: list[int] | None = None
        self.total = -np.inf
        self.stuck = Stuck(0, None)
        self.deepest = -1

    def accepted(self, joint: int, a: int) -> bool:
        """Whether a candidate is good by itself; once refused it is never tried again."""
        good = self._accept(joint, a)
        if not good and self.open[joint][a]:
            self.open[joint][a] = False
            self.refusals += 1
        return good

    def descend(self, chosen: list[int], left: list[Mask]) -> None:
        """Try every candidate of the next joint that those chosen leave over."""
        joint = len(chosen)
        if joint == len(self.scores):
            if all(self.accepted(i, a) for i, a in enumerate(chosen)):
                self.best, self.total = list(chosen), self.sum(chosen)
            return
        before = self.sum(chosen)
        found, refused = False, np.zeros(len(chosen), int)
        after, refusals = 0.0, -1
        for a in np.flatnonzero(left[joint]).tolist():
            if refusals != self.refusals:  # else nothing here has changed
                refusals = self.refusals
                after = sum(self.top(i, left[i]) for i in range(joint + 1, len(self.scores)))
                if not all(self.open[i][b] for i, b in enumerate(chosen)):
                    return
            if before + float(self.scores[joint][a]) + after <= self.total or self.steps <= 0:
                break
            if not self.open[joint][a]:
                continue
            self.steps -= 1
            near = next((i for i, b in enumerate(chosen) if not self._clear(i, b, joint, a)), None)
            if near is not None:
                refused[near] += 1
                continue
            found = True
            later = range(joint + 1, len(self.scores))
            narrowed = [m & self._possible(joint, a, i) if i in later else m for i, m in enumerate(left)]
            dead = next((i for i in later if not (narrowed[i] & self.open[i]).any()), None)
            if dead is None:
                self.descend([*chosen, a], narrowed)
            elif joint > self.deepest:
                self.deepest, self.stuck = joint, Stuck(dead, joint)
        if not found and self.best is None and joint > self.deepest:
            self.deepest, self.stuck = joint, Stuck(joint, self.blocker(chosen, refused))

    def sum(self, chosen: list[int]) -> float:
        """Sum of the scores of the joints that have a candidate."""
        return float(sum(s[a] for s, a in zip(self.scores, chosen, strict=False)))

    def top(self, joint: int, left: Mask) -> float:
        """The greatest score that a joint can still have."""
        some = left & self.open[joint]
        first = int(some.argmax())
        return float(self.scores[joint][first]) if some[first] else -np.inf

    def blocker(self, chosen: list[int], refused: NDArray[np.int64]) -> int | None:
        """The joint whose candidate rules most of the next joint's candidates out, at once or on a closer look."""
        joint = len(chosen)
        ruled_out = [int((~self._possible(i, a, joint)).sum()) + int(refused[i]) for i, a in enumerate(chosen)]
        return int(np.argmax(ruled_out)) if ruled_out else None
