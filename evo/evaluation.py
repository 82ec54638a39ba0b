"""What was asked and what came of it; every record names its candidate, so that results never travel by position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evo.fitness import RankKey, rank_key
from mfg.outcome import Failure, Scores
from sim.actor import Gait


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """One latent that was asked for.

    Attributes:
        generation: from 0.
        index: place in what `CmaEs.ask` returned for that generation, from 0.
        latent: shape (512,), single precision.
    """

    generation: int
    index: int
    latent: NDArray[np.float32]

    def seed(self, run_seed: int, purpose: int) -> np.random.SeedSequence:
        """The candidate's own randomness; it depends on no other candidate and on no worker.

        Args:
            run_seed: of the whole run.
            purpose: keeps the streams of different uses of one candidate apart.
        """
        return np.random.SeedSequence(run_seed, spawn_key=(purpose, self.generation, self.index))


@dataclass(frozen=True, eq=False, slots=True)
class Walk:
    """How a body moved with the best gait that was found for it.

    Attributes:
        gait: that gait.
        task: task fitness [m/s]: what the gait search maximises, `sim.gaits.score`, or what a policy learns after it.
        speed: along the best heading of the body [m/s], as `sim.rollout.Behaviour` defines it.
        heading: that heading, from the body's x axis [rad].
        distance: net horizontal displacement within the episode [m].
        episode: its simulated length [s].
        body_length: greatest extent at rest [m].
        mass: of the whole robot [kg].
    """

    gait: Gait
    task: float
    speed: float
    heading: float
    distance: float
    episode: float
    body_length: float
    mass: float

    @property
    def walks(self) -> bool:
        """Whether it moved at least one body length."""
        return self.distance >= self.body_length


@dataclass(frozen=True, eq=False, slots=True)
class Evaluation:
    """The answer for one candidate.

    Attributes:
        candidate: whom it is about.
        design: key of the decoded design; None where the worker was lost before it could tell.
        scores: of the stages that were passed.
        failure: why it cannot be built, or None.
        walk: how it moves; None if it was not simulated.
        fitness: by the run's rule; None for a failure and for one that breaks the rule's constraint.
        stages: wall time of every stage [s]; the only part that differs between two runs of the same seed.
        changes: made to the decoded body, in words and in order; only a repaired body has any.
        repaired: the answer for the body changed as little as helps; None where that was not asked for or needed.
    """

    candidate: Candidate
    design: str | None = None
    scores: Scores = field(default_factory=Scores)
    failure: Failure | None = None
    walk: Walk | None = None
    fitness: float | None = None
    stages: Mapping[str, float] = field(default_factory=dict)
    changes: tuple[str, ...] = ()
    repaired: Evaluation | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be ordered."""
        rank_key(self.fitness, self.failure, self.scores)

    @property
    def passed(self) -> bool:
        """Whether it can be built."""
        return self.failure is None

    @property
    def rank_key(self) -> RankKey:
        """Place among all evaluations, smaller is better; ties are broken by who was asked first."""
        key = rank_key(self.fitness, self.failure, self.scores)
        return (*key, float(self.candidate.generation), float(self.candidate.index))
