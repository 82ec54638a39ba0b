"""The configuration of `bodyplan train` and of `kind = "policy"`: a frozen record, from flags or from TOML."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta, Struct

from experiments.output import DEFAULT_SOLVER, SEED_BOUND, Solvers

if TYPE_CHECKING:
    from sim.model import Model
    from sim.plan import Training


RATE = 7e-4  # of learning; short trainings walk sooner by the usual one, long ones were measured by this one
# What is learned about a gait that holds: more exploration or a higher rate would unlearn it.
SPREAD, SLOWER = 0.25, 0.5


class Policy(Struct, frozen=True, forbid_unknown_fields=True):
    """A training of one robot's policy.

    Attributes:
        kind: "policy".
        robot: a blueprint folder, its robot.xml, or a design; relative to a configuration file that names it.
        solver: how manufacturing constraints are solved, where the robot is a design that is built first.
        seed: of everything random.
        steps: control periods after the race, all copies together.
        generations: of the searches that make open-loop gaits hold on robots that differ; 0 takes gaits as they are.
        starts: what races: the open-loop gait that holds best, or two not made to hold, and free policies along
            headings of the body; 1 takes a gait.
        race_steps: control periods of each that learns, after which the training goes on from the best one's learner.
        chunk: control periods between two evaluations and checkpoints.
        copies: robots that gather experience together.
        task: what is learned.
        pace: how fast it is to be [body lengths/s]; faster costs reward, because a policy by which all of the drawn
            robots go at one pace keeps its speed on the real one.
        history: frames that the policy sees.
        randomise: whether episodes draw latency, gains, friction, masses, sensor errors and pushes.
        pads: share of the robots, in training and in the episodes that choose the best, that stand on sprung pads; the
            best is chosen by what it keeps on pads and on flexible skin, too, unless this is 0.
        terrain: what the robot walks on.
        film: length of the film [s], 0 for none. It changes no result.
    """

    kind: Literal["policy"]
    robot: Annotated[str, Meta(min_length=1)]
    solver: Solvers = DEFAULT_SOLVER
    seed: Annotated[int, Meta(ge=0, le=SEED_BOUND - 1)] = 0
    steps: Annotated[int, Meta(ge=1000, le=1_000_000_000)] = 400_000
    generations: Annotated[int, Meta(ge=0, le=10_000)] = 36
    starts: Annotated[int, Meta(ge=1, le=16)] = 3
    race_steps: Annotated[int, Meta(ge=1000, le=100_000_000)] = 160_000
    chunk: Annotated[int, Meta(ge=1000, le=100_000_000)] = 100_000
    copies: Annotated[int, Meta(ge=1, le=65_536)] = 64
    task: Literal["speed", "command", "stand", "recover"] = "speed"
    pace: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.65
    history: Annotated[int, Meta(ge=1, le=16)] = 1
    randomise: bool = True
    pads: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.35  # 7 of the 20 episodes that choose the best
    terrain: Literal["flat", "rough", "potholes", "slope", "steps"] = "flat"
    film: Annotated[float, Meta(ge=0.0, le=100.0)] = 10.0

    @property
    def held(self) -> bool:
        """Whether open-loop gaits are made to hold before policies correct them."""
        return self.randomise and self.generations > 0

    def training(self, model: Model) -> Training:
        """As the trainer of a robot wants it."""
        from dataclasses import replace

        from sim.environment import TEN_SECONDS
        from sim.plan import USUAL, Training
        from sim.randomisation import WIDE
        from sim.surfaces import body_length
        from sim.tasks import STEADY, Goal

        task = replace(STEADY, goal=Goal(self.task), target_speed=self.pace * body_length(model))
        training = Training(
            self.seed, self.steps, self.chunk, replace(USUAL, copies=self.copies, learning_rate=RATE), task,
            WIDE if self.randomise else None, replace(TEN_SECONDS, history=self.history),
            share=self.pads,
        )  # fmt: skip
        if not self.held:
            return training
        return replace(training, rhythm_spread=SPREAD, rhythm_rate=SLOWER)
