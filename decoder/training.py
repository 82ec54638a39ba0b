"""Training the learned decoder: steps on bodies drawn for each, saved and resumed exactly."""

from __future__ import annotations

import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from decoder import networks
from decoder.examples import Examples, examples, seen
from decoder.genome import LATENT_DIM
from decoder.linear_start import linear_start
from decoder.parts import MAX_PARTS, POSE, TOLERANCES, TRUNCATION
from decoder.synthetic import generator, sample_bodies
from decoder.weights import Weights

_LATTICE_TOLERANCE = 0.30  # of a signed distance [voxels],
_LATTICE_WORTH = 60.0  # as if so many nodes of a lattice were independent
_CHOICE_WORTH = 5.0  # of existence and of the carrier, in nats per nat
_NANS_ALLOWED = 20  # steps in a row without a finite loss
_GROUP = 4096  # bodies that the prior's mean and covariance are taken from
_FORMAT = "bodyplan-decoder-checkpoint-1"


class TrainingError(ValueError):
    """A checkpoint that cannot be used."""


class Diverged(RuntimeError):
    """The loss stayed without a finite value."""


@dataclass(frozen=True)
class Settings:
    """How to train.

    Attributes:
        seed: of the weights, the bodies and the noise.
        steps: in all; the learning rate falls to a hundredth of its greatest over them.
        batch: bodies per step.
        learning_rate: the greatest.
        warmup: steps over which it rises.
        ema: decay per step of the running mean of the weights.
        precision: "fp32" or "bf16" for the products of matrices.
        device: "cpu" or "cuda".
        threads: on the CPU; 0 leaves it to torch.
        start_bodies: that a training from scratch takes its linear start from, 256 or more; 0 begins with noise.
    """

    seed: int = 0
    steps: int = 10_000
    batch: int = 64
    learning_rate: float = 1e-3
    warmup: int = 200
    ema: float = 0.999
    precision: str = "fp32"
    device: str = "cpu"
    threads: int = 0
    start_bodies: int = 2048


class Training:
    """State of one training: weights, their running mean, the optimiser's moments, and how far it is."""

    def __init__(self, settings: Settings, arrays: dict[str, Tensor]) -> None:
        """Begin at step 0 with these weights."""
        self.settings = settings
        self.step = 0
        self.failures = 0
        self._arrays = {name: a.to(settings.device).requires_grad_(True) for name, a in arrays.items()}
        self._mean = {name: a.detach().clone() for name, a in self._arrays.items()}
        decayed = [a for name, a in self._arrays.items() if a.ndim == 2 and not name.endswith("place")]
        rest = [a for name, a in self._arrays.items() if not (a.ndim == 2 and not name.endswith("place"))]
        groups = [{"params": decayed, "weight_decay": 0.01}, {"params": rest, "weight_decay": 0.0}]
        self._optimiser = torch.optim.AdamW(groups, lr=0.0, betas=(0.9, 0.98))
        self._worker = ThreadPoolExecutor(1)
        self._next: tuple[int, Future[Examples]] | None = None
        if settings.threads:
            torch.set_num_threads(settings.threads)

    @classmethod
    def start(cls, settings: Settings, weights: Weights | None) -> Training:
        """Begin from scratch, or go on from weights."""
        if weights is None:
            with torch.no_grad():
                arrays = (
                    linear_start(settings.seed, settings.start_bodies)
                    if settings.start_bodies
                    else networks.initial(np.random.default_rng(settings.seed))
                )
        else:
            arrays = {name: np.array(a) for name, a in weights.arrays.items()}
        return cls(settings, {n: torch.tensor(a) for n, a in arrays.items() if not n.startswith("prior.")})

    def advance(self) -> dict[str, float]:
        """Take one step on bodies drawn for it; return the terms of the loss in nats per body.

        A step without a finite loss or gradient changes nothing but the count of steps.

        Raises:
            Diverged: after 20 such steps in a row.
        """
        batch = self._batch()
        rng = generator(self.settings.seed, 2 * self.step + 1)
        noise = torch.randn((len(batch.alive), LATENT_DIM), generator=rng).to(self.settings.device)
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        bf16 = self.settings.precision == "bf16"
        with torch.autocast(self.settings.device, torch.bfloat16, enabled=bf16):
            terms = losses(self._arrays, batch, noise, self._pressure())
        total = terms["loss"]
        self._optimiser.zero_grad(set_to_none=True)
        total.backward()
        norm = torch.nn.utils.clip_grad_norm_(list(self._arrays.values()), 50.0)
        self.step += 1
        if not (math.isfinite(float(total.detach())) and math.isfinite(float(norm))):
            self.failures += 1
            if self.failures >= _NANS_ALLOWED:
                raise Diverged(f"the loss had no finite value for {_NANS_ALLOWED} steps, the last of them {self.step}")
            return {name: float(value.detach()) for name, value in terms.items()}
        self.failures = 0
        self._optimiser.step()
        decay = min(self.settings.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            names = list(self._arrays)
            torch._foreach_lerp_([self._mean[n] for n in names], [self._arrays[n] for n in names], 1 - decay)
        return {name: float(value.detach()) for name, value in terms.items()} | {"gradient": float(norm)}

    def _learning_rate(self) -> float:
        s = self.settings
        rise = min(1.0, (self.step + 1) / max(1, s.warmup))
        done = min(1.0, max(0.0, (self.step - s.warmup) / max(1, s.steps - s.warmup)))
        return s.learning_rate * rise * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done)))

    def _pressure(self) -> float:
        """Weight of the divergence from the prior: 0.05 at first, 1 from half of the steps on."""
        done = self.step / max(1, self.settings.steps)
        return float(0.05 ** max(0.0, 1.0 - 2.0 * done))

    def _batch(self) -> Examples:
        """The bodies of this step; those of the next are drawn meanwhile."""
        if self._next is None or self._next[0] != self.step:
            self._next = (self.step, self._worker.submit(self._draw, self.step))
        batch = self._next[1].result()
        following = self.step + 1
        self._next = (following, self._worker.submit(self._draw, following))
        return batch

    def _draw(self, step: int) -> Examples:
        rng = generator(self.settings.seed, 2 * step, self.settings.device)
        with torch.no_grad():
            return examples(sample_bodies(self.settings.batch, rng))

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Mean weights, with the map that makes latents of this training's bodies white."""
        mean, square, count = np.zeros(LATENT_DIM), np.zeros((LATENT_DIM, LATENT_DIM)), 0
        arrays = {name: a.float() for name, a in self._mean.items()}
        for index in range(_GROUP // 256):
            rng = generator(self.settings.seed, 2**40 + index, self.settings.device)
            with torch.no_grad():
                mu, spread = networks.encode(arrays, *seen(examples(sample_bodies(256, rng))), torch)
            noise = torch.randn(mu.shape, generator=generator(self.settings.seed, 2**41 + index)).to(mu.device)
            z = (mu + noise * (0.5 * spread).exp()).cpu().double().numpy()
            mean += z.sum(0)
            square += z.T @ z
            count += len(z)
        mean /= count
        values, vectors = np.linalg.eigh(square / count - np.outer(mean, mean))
        scale = np.sqrt(np.maximum(values, 1e-4))
        prior = {
            "prior.mean": mean,
            "prior.spread": (vectors * scale) @ vectors.T,
            "prior.whiten": (vectors / scale) @ vectors.T,
        }
        return {n: a.cpu().numpy() for n, a in arrays.items()} | {n: a.astype(np.float32) for n, a in prior.items()}

    def save(self, path: Path) -> None:
        """Write everything that going on needs, exactly here."""
        torch.save(
            {"format": _FORMAT, "settings": asdict(self.settings), "step": self.step, "failures": self.failures,
             "arrays": {n: a.detach().cpu() for n, a in self._arrays.items()},
             "mean": {n: a.cpu() for n, a in self._mean.items()}, "optimiser": self._optimiser.state_dict()},
            path,
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path, settings: Settings) -> Training:
        """Go on from a checkpoint; device, precision and threads may differ.

        Raises:
            TrainingError: if it is no checkpoint of these settings.
            OSError: if it cannot be read.
        """
        state = _read(path)
        free = ("device", "precision", "threads")
        for name, value in asdict(settings).items():
            if name not in free and state["settings"].get(name) != value:
                raise TrainingError(f"{path}: {name} was {state['settings'].get(name)}, now it is {value}")
        training = cls(settings, state["arrays"])
        training.step, training.failures = int(state["step"]), int(state["failures"])
        training._mean = {n: a.to(settings.device) for n, a in state["mean"].items()}
        training._optimiser.load_state_dict(state["optimiser"])
        return training


def _read(path: Path) -> dict[str, Any]:
    wanted = {n: s for n, s in networks.shapes({}).items() if not n.startswith("prior.")}
    try:
        # Only tensors and plain containers: no code of the file runs.
        state = torch.load(path, map_location="cpu", weights_only=True)
        right = state["format"] == _FORMAT and {n: tuple(a.shape) for n, a in state["arrays"].items()} == wanted
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - torch raises a dozen kinds on bytes that are no checkpoint.
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise TrainingError(f"{path}: not a readable checkpoint ({reason}); begin anew") from None
    if not right:
        raise TrainingError(f"{path}: a checkpoint of another program or network; begin anew")
    return dict(state)


def losses(w: dict[str, Tensor], batch: Examples, noise: Tensor, pressure: float) -> dict[str, Tensor]:
    """Negative evidence bound of a batch and its terms, nats per body."""
    lattices, pose = seen(batch)
    mu, spread = networks.encode(w, lattices, pose, torch)
    mu, spread = mu.float(), spread.float()
    divergence = 0.5 * (mu * mu + spread.exp() - 1 - spread).sum(1).mean()
    said, distance = networks.decode(w, mu + noise * (0.5 * spread).exp(), torch)
    said, distance = said.float(), distance.float()
    n = len(mu)
    alive = batch.alive.float()
    existence = functional.binary_cross_entropy_with_logits(said[:, 1:, 0], alive[:, 1:], reduction="sum") / n
    guess = functional.cross_entropy(said[..., 1 : 1 + MAX_PARTS].transpose(1, 2), batch.parent, reduction="none")
    carrier = (guess[:, 1:] * alive[:, 1:]).sum() / n
    terms = {"existence": _CHOICE_WORTH * existence, "carrier": _CHOICE_WORTH * carrier}
    wrong = (said[..., -POSE:] - batch.pose) * alive[..., None]
    for name, part, tolerance in TOLERANCES:
        terms[name] = _cost(wrong[..., part] / tolerance).sum() / n
    truth = batch.distance.flatten(2)
    near = torch.where(truth.abs() < 2.0, 1.0, 0.15)
    miss = _cost((TRUNCATION * distance - truth) / _LATTICE_TOLERANCE)
    weighted = (near * miss).view(n, MAX_PARTS, 2, -1).sum(3) / near.view(n, MAX_PARTS, 2, -1).sum(3)
    terms["surface"] = _LATTICE_WORTH * (weighted * alive[..., None]).sum() / n
    terms["divergence"] = divergence
    loss: Tensor = sum(value for name, value in terms.items() if name != "divergence") + pressure * divergence
    return terms | {"loss": loss}


def _cost(x: Tensor) -> Tensor:
    """Half a square near 0, growing linearly beyond 3."""
    a = x.abs()
    return torch.where(a < 3.0, 0.5 * x * x, 3.0 * a - 4.5)
