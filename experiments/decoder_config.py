"""The configuration of `bodyplan train-decoder`: TOML in, a frozen record out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from experiments.config import Seed, Workers
from experiments.output import BadInput
from experiments.toml_document import checked, read_document

KIND = "train-decoder"
CURVE_SEED = 2_000_000_017  # of the bodies that the curve is measured on; others than those of the closing evaluation
# Keys that change neither what is learned nor how: a run may be resumed with other values of them. Where and how
# precisely the sums are made is among them, and a change is told, for it changes rounding.
FREE = ("device", "precision", "threads", "checkpoint_every", "evaluate_every", "evaluate_bodies", "evaluation.bodies",
        "evaluation.samples")  # fmt: skip


class Evaluation(Struct, frozen=True, forbid_unknown_fields=True):
    """The closing evaluation, by which two sets of weights are compared.

    Attributes:
        bodies: held-out bodies that are encoded and decoded.
        samples: latents drawn from the prior and decoded.
    """

    bodies: Annotated[int, Meta(ge=1, le=100_000)] = 500
    samples: Annotated[int, Meta(ge=2, le=100_000)] = 1000


class TrainDecoder(Struct, frozen=True, forbid_unknown_fields=True):
    """A training of the learned decoder.

    Attributes:
        kind: "train-decoder".
        seed: of everything random.
        start: "shipped" goes on from the weights of the package where there are some, "scratch" from nothing.
        steps: of the optimiser for encoder and decoder; the learning rate falls towards the last.
        flow_steps: after those, for the flow of the prior; once more the learning rate falls towards the last.
        batch: bodies per step.
        learning_rate: the greatest.
        warmup: steps over which the learning rate rises.
        ema: decay per step of the running mean of the weights, which is what is kept.
        start_bodies: that a training from scratch takes its linear start from; 0 begins with noise.
        device: where; "auto" takes a GPU if there is one.
        precision: of the sums; "auto" is bf16 on a GPU or a CPU with matrix units (AMX), fp32 elsewhere. Either way
            bf16 is used only if it agrees with fp32 on one batch.
        threads: on the CPU; 0 is one per core.
        checkpoint_every: steps between checkpoints, the most that a crash can cost.
        evaluate_every: steps between rows of the curve.
        evaluate_bodies: held-out bodies per row.
        evaluation: the closing one.
    """

    kind: Literal["train-decoder"]
    seed: Seed = 0
    start: Literal["shipped", "scratch"] = "shipped"
    steps: Annotated[int, Meta(ge=1, le=100_000_000)] = 10_000
    flow_steps: Annotated[int, Meta(ge=0, le=100_000_000)] = 5_000
    batch: Annotated[int, Meta(ge=1, le=65_536)] = 64
    learning_rate: Annotated[float, Meta(gt=0.0, le=1.0)] = 8e-4
    warmup: Annotated[int, Meta(ge=0, le=1_000_000)] = 200
    ema: Annotated[float, Meta(ge=0.0, le=0.999999)] = 0.999
    start_bodies: Annotated[int, Meta(ge=0, le=100_000)] = 2048
    device: Literal["auto", "cpu", "cuda"] = "auto"
    precision: Literal["auto", "fp32", "bf16"] = "auto"
    threads: Workers = 0
    checkpoint_every: Annotated[int, Meta(ge=1, le=1_000_000)] = 200
    evaluate_every: Annotated[int, Meta(ge=1, le=10_000_000)] = 500
    evaluate_bodies: Annotated[int, Meta(ge=1, le=10_000)] = 16
    evaluation: Evaluation = Evaluation()

    @property
    def last_step(self) -> int:
        """Of both."""
        return self.steps + self.flow_steps


def load_decoder_config(path: Path) -> TrainDecoder:
    """Read a configuration file.

    Raises:
        BadInput: naming the file, the key, its value and what is allowed.
        OSError: if it cannot be read.
    """
    from decoder.evaluation import HELD_OUT_SEED

    document = read_document(path)
    kind = document.get("kind")
    if kind is None:
        raise BadInput(f'{path}: kind is missing; add a line kind = "{KIND}"')
    if kind in ("evolve", "study", "sketch"):
        raise BadInput(f'{path}: kind = "{kind}"; it must be "{KIND}" here: give this file to `bodyplan run`')
    config = checked(document, TrainDecoder, str(path))
    if config.seed in (CURVE_SEED, HELD_OUT_SEED):
        raise BadInput(f"{path}: seed = {config.seed}; that seed is kept for held-out bodies: choose another")
    for name, steps in (("steps", config.steps), ("flow_steps", config.flow_steps)):
        if config.warmup >= steps > 1:
            raise BadInput(f"{path}: warmup = {config.warmup}; it must be less than {name} = {steps}")
    return config
