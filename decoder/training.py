"""Training the learned decoder, then the flow of its prior: on bodies drawn for every step, resumed exactly."""

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
from decoder.linear_start import linear_start
from decoder.parts import MAX_PARTS, POSE, TOLERANCES, TRUNCATION
from decoder.synthetic import generator, sample_bodies
from decoder.weights import Weights

_LATTICE_TOLERANCE = 0.30  # of a signed distance [voxels],
_LATTICE_WORTH = 60.0  # as if so many nodes of a lattice were independent
_CHOICE_WORTH = 5.0  # of existence and of the carrier, in nats per nat
_NANS_ALLOWED = 20  # steps in a row without a finite loss
_PATHS = 16  # of the flow, per body and step
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
        steps: that encoder and decoder learn in; the learning rate falls to a hundredth of its greatest over them.
        flow_steps: that the flow learns in afterwards, from what the encoder has become; the rate falls once more.
        batch: bodies per step.
        learning_rate: the greatest.
        warmup: steps over which it rises, both times.
        ema: decay per step of the running mean of the weights.
        precision: "fp32" or "bf16" for the products of matrices.
        device: "cpu" or "cuda".
        threads: on the CPU, half of them to learn and half to draw bodies meanwhile; 0 leaves it to torch.
        start_bodies: that a training from scratch takes its linear start from, 256 or more; 0 begins with noise.
    """

    seed: int = 0
    steps: int = 10_000
    flow_steps: int = 5_000
    batch: int = 64
    learning_rate: float = 8e-4
    warmup: int = 200
    ema: float = 0.999
    precision: str = "fp32"
    device: str = "cpu"
    threads: int = 0
    start_bodies: int = 2048


def has_bf16(device: str) -> bool:
    """Whether products of bf16 matrices are faster there than those of fp32: on GPUs, and CPUs with matrix units."""
    if device != "cpu":
        return True
    ask = getattr(torch.cpu, "get_capabilities", None)  # since torch 2.11
    return ask is not None and bool(ask().get("amx_bf16"))


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
        self._optimiser = torch.optim.AdamW(groups, lr=0.0, betas=(0.9, 0.98), fused=True)
        self._worker = ThreadPoolExecutor(1)
        self._next: tuple[int, Future[Examples]] | None = None
        if settings.threads:
            torch.set_num_threads(max(1, settings.threads // 2))

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
        return cls(settings, {name: torch.tensor(array) for name, array in arrays.items()})

    def advance(self) -> dict[str, float]:
        """Take one step on bodies drawn for it; return the terms of the loss in nats per body.

        A step without a finite loss or gradient changes nothing but the count of steps.

        Raises:
            Diverged: after 20 such steps in a row.
        """
        batch = self._batch()
        rng = generator(self.settings.seed, 2 * self.step + 1, self.settings.device)
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        bf16 = self.settings.precision == "bf16"
        flowing = self.step >= self.settings.steps
        with torch.autocast(self.settings.device, torch.bfloat16, enabled=bf16):
            if flowing:
                terms = flow_losses(self._arrays, self._mean, batch, rng)
            else:
                terms = losses(self._arrays, batch, rng, self._pressure())
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
        done = self.step - flowing * self.settings.steps
        decay = min(self.settings.ema, (1 + done) / (10 + done))
        with torch.no_grad():
            names = [name for name in self._arrays if name.startswith("flow.") == flowing]
            torch._foreach_lerp_([self._mean[n] for n in names], [self._arrays[n] for n in names], 1 - decay)
        return {name: float(value.detach()) for name, value in terms.items()} | {"gradient": float(norm)}

    def _learning_rate(self) -> float:
        s = self.settings
        flowing = self.step >= s.steps
        step, steps = (self.step - s.steps, s.flow_steps) if flowing else (self.step, s.steps)
        rise = min(1.0, (step + 1) / max(1, s.warmup))
        done = min(1.0, max(0.0, (step - s.warmup) / max(1, steps - s.warmup)))
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
        """Mean weights."""
        return {name: array.float().cpu().numpy() for name, array in self._mean.items()}

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
    wanted = networks.shapes({})
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


def losses(w: dict[str, Tensor], batch: Examples, rng: torch.Generator, pressure: float) -> dict[str, Tensor]:
    """Negative evidence bound of a batch and its terms, nats per body."""
    mu, spread = networks.encode(w, *seen(batch), torch)
    mu, spread = mu.float(), spread.float()
    divergence = 0.5 * (mu * mu + spread.exp() - 1 - spread).sum(1).mean()
    noise = torch.randn(mu.shape, generator=rng, device=mu.device)
    said, tokens = networks.decode(w, mu + noise * (0.5 * spread).exp(), torch)
    distance = networks.distances(w, tokens, batch.alive, torch)
    said = said.float()
    n = len(mu)
    alive = batch.alive.float()
    existence = functional.binary_cross_entropy_with_logits(said[:, 1:, 0], alive[:, 1:], reduction="sum") / n
    guess = functional.cross_entropy(said[..., 1 : 1 + MAX_PARTS].transpose(1, 2), batch.parent, reduction="none")
    carrier = (guess[:, 1:] * alive[:, 1:]).sum() / n
    terms = {"existence": _CHOICE_WORTH * existence, "carrier": _CHOICE_WORTH * carrier}
    wrong = (said[..., -POSE:] - batch.pose) * alive[..., None]
    for name, part, tolerance in TOLERANCES:
        terms[name] = _cost(wrong[..., part] / tolerance).sum() / n
    truth = batch.distance.flatten(1)
    near = torch.where(truth.abs() < 2.0, 1.0, 0.15)
    miss = _cost((TRUNCATION * distance - truth) / _LATTICE_TOLERANCE)
    weighted = (near * miss).view(len(truth), 2, -1).sum(2) / near.view(len(truth), 2, -1).sum(2)
    terms["surface"] = _LATTICE_WORTH * weighted.sum() / n
    terms["divergence"] = divergence
    loss: Tensor = sum(value for name, value in terms.items() if name != "divergence") + pressure * divergence
    return terms | {"loss": loss}


def flow_losses(
    w: dict[str, Tensor], encoder: dict[str, Tensor], batch: Examples, rng: torch.Generator
) -> dict[str, Tensor]:
    """Half the square by which the flow misses the velocity of points on their ways, per body.

    Ways are straight, from draws of N(0, I) to draws of the posterior; the flow that misses least on average carries
    the one law to the other (conditional flow matching, Lipman et al. 2023).
    """
    with torch.no_grad():
        mu, spread = (each.float() for each in networks.encode(encoder, *seen(batch), torch))
    start, noise = torch.randn((2, _PATHS, *mu.shape), generator=rng, device=mu.device)
    end = mu + noise * (0.5 * spread).exp()
    late = torch.rand((_PATHS, len(mu), 1), generator=rng, device=mu.device)
    time = (torch.arange(_PATHS, device=mu.device)[:, None, None] + late) / _PATHS
    found = networks.velocity(w, torch.lerp(start, end, time).flatten(0, 1), time.flatten(0, 1), torch)
    miss = 0.5 * (found.float() - (end - start).flatten(0, 1)).square().sum(1).mean()
    return {"flow": miss, "loss": miss}


def _cost(x: Tensor) -> Tensor:
    """Half a square near 0, growing linearly beyond 3."""
    return functional.huber_loss(x, torch.zeros((), dtype=x.dtype, device=x.device).expand_as(x), "none", delta=3.0)
