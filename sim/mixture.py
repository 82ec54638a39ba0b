"""Environments of one robot that model it differently, stepped as one: a policy learns on all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.environment import Environment, Explosion, Step

if TYPE_CHECKING:
    from sim.actor import Gait
    from sim.observation import ActionMap, ObservationLayout
    from sim.tasks import Task

Array = NDArray[np.float64]


class Mixture:
    """As one environment, whose copies are those of its parts in order.

    Attributes:
        parts: environments with the same joints, actions, task and rhythm; they share their list of explosions.
        count: of copies in all.
    """

    def __init__(self, parts: Sequence[Environment]) -> None:
        """Join environments.

        Raises:
            ValueError: if there is none, or policies of one would not fit another.
        """
        if not parts:
            raise ValueError("a mixture of no environments; it needs at least one")
        if any(part.layout != parts[0].layout or part.herd.names != parts[0].herd.names for part in parts):
            raise ValueError("the environments of a mixture must have the same joints and observations")
        self.parts = tuple(parts)
        self.explosions: list[Explosion] = []  # the first states that were lost, of all parts
        for place, part in enumerate(parts):
            part.explosions, part.kind = self.explosions, place
        self.count = sum(part.count for part in parts)
        self._cuts = np.cumsum([part.count for part in parts])[:-1]

    @property
    def layout(self) -> ObservationLayout:
        """Of an observation."""
        return self.parts[0].layout

    @property
    def map(self) -> ActionMap:
        """From what a policy says to joint targets."""
        return self.parts[0].map

    @property
    def task(self) -> Task:
        """What earns reward."""
        return self.parts[0].task

    @property
    def rhythm(self) -> Gait | None:
        """Gait that the policy corrects."""
        return self.parts[0].rhythm

    @property
    def lost(self) -> int:
        """How many copies were lost in all."""
        return sum(part.lost for part in self.parts)

    def reset(self, rng: np.random.Generator) -> Array:
        """Begin anew; every part draws from a generator of its own, a child of `rng`."""
        return np.concatenate([p.reset(child) for p, child in zip(self.parts, rng.spawn(len(self.parts)), strict=True)])

    def step(self, said: ArrayLike) -> Step:
        """Let a control period pass under what the policy says, (count, n)."""
        said = np.asarray(said, dtype=np.float64)
        steps = [part.step(rows) for part, rows in zip(self.parts, np.split(said, self._cuts), strict=True)]
        shares = [part.count / self.count for part in self.parts]
        means = {name: sum(share * s.parts[name] for share, s in zip(shares, steps, strict=True))
                 for name in steps[0].parts}  # fmt: skip
        joined = {
            name: np.concatenate([getattr(step, name) for step in steps])
            for name in (f.name for f in fields(Step) if f.name != "parts")
        }
        return Step(**joined, parts=means)

    @property
    def hidden_size(self) -> int:
        """How many numbers of a copy only the simulator knows."""
        return self.parts[0].hidden_size

    def hidden(self) -> Array:
        """What only the simulator knows of every copy, (count, hidden_size)."""
        return np.concatenate([part.hidden() for part in self.parts])
