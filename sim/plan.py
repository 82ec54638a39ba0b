"""What a training is to do: by which learner, for which task, on which robots."""

from __future__ import annotations

from dataclasses import dataclass

from sim.environment import TEN_SECONDS, Episode
from sim.randomisation import RANDOMISED, WIDE, Randomisation
from sim.tasks import FAST, Task


@dataclass(frozen=True, slots=True)
class Ppo:
    """Settings of the learner.

    Attributes:
        copies: robots that gather experience together.
        horizon: control periods between two updates.
        epochs: passes over the experience of one update.
        minibatch: samples of one gradient step.
        learning_rate: of Adam.
        gamma: discount of one control period.
        trace: lambda of the generalised advantage.
        clip: of the probability ratio.
        spread: first standard deviation of what the policy says.
        units: width of both hidden layers.
    """

    copies: int = 64
    horizon: int = 32
    epochs: int = 4
    minibatch: int = 512
    learning_rate: float = 1e-3
    gamma: float = 0.99
    trace: float = 0.95
    clip: float = 0.2
    spread: float = 0.6
    units: int = 64

    def __post_init__(self) -> None:
        """Check that advantages can be normalised."""
        if self.minibatch < 2 or self.update % self.minibatch == 1:
            raise ValueError(
                f"learner: minibatches of {self.minibatch} samples leave a single one of the {self.update} "
                "of an update; every minibatch needs two"
            )

    @property
    def update(self) -> int:
        """Samples of one update."""
        return self.copies * self.horizon


USUAL = Ppo()


@dataclass(frozen=True, slots=True)
class Training:
    """One training.

    Attributes:
        seed: of everything.
        steps: control periods of all copies together.
        chunk: so many between two evaluations.
        ppo: the learner.
        task: what is learned; its heading is that of the start.
        randomisation: what each episode draws; None trains on the model as it is.
        episode: how episodes run.
        rhythm_spread: of the first exploration about a rhythm over that of a free start.
        rhythm_rate: of the learning rate about a rhythm over that of a free start.
        last_spread: standard deviation of what the policy says at the end.
        share: of the copies and of the episodes of an evaluation that have another model of the robot, if there is one.
        claimed: what the policy is to bear: the best is chosen by that, while training may go beyond it.
    """

    seed: int = 0
    steps: int = 800_000
    chunk: int = 100_000
    ppo: Ppo = USUAL
    task: Task = FAST
    randomisation: Randomisation | None = WIDE
    episode: Episode = TEN_SECONDS
    rhythm_spread: float = 2 / 3
    rhythm_rate: float = 1.0
    last_spread: float = 0.08
    share: float = 0.25
    claimed: Randomisation = RANDOMISED

    def __post_init__(self) -> None:
        """Check the bounds."""
        if self.steps < 1 or self.chunk < 1:
            raise ValueError(f"training: steps {self.steps} and chunk {self.chunk} must be 1 or more")
        for name in ("rhythm_spread", "rhythm_rate"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"training: {name} is {getattr(self, name)}; it must lie in (0, 1]")
        if not 0.01 <= self.last_spread <= self.ppo.spread:
            raise ValueError(f"training: last_spread is {self.last_spread}; it must lie in [0.01, {self.ppo.spread:g}]")
        if not 0.0 <= self.share <= 0.9:
            raise ValueError(f"training: share is {self.share}; it must lie in [0, 0.9]")

    @property
    def chunks(self) -> int:
        """How many."""
        return -(-self.steps // self.chunk)

    def simulated(self, chunks: int) -> int:
        """Control periods after so many chunks: each is rounded up to whole updates of the learner."""
        steps = [min(self.chunk, self.steps - index * self.chunk) for index in range(chunks)]
        return sum(-(-step // self.ppo.update) * self.ppo.update for step in steps)
