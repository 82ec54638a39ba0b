"""CMA-ES over the latent space: the one door to pycma."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Literal

import cma
import numpy as np
from numpy.typing import NDArray

MIN_POPSIZE = 4  # the least that pycma takes without mirrored samples
MAX_DIM = 100_000


Start = Literal["best", "origin"]


class CmaEs:
    """Ask for latents, tell their order; z ~ N(m, s² C) with a diagonal C.

    Diagonal, because a body costs seconds: with a few thousand evaluations in 512 dimensions a full covariance has no
    time to form. Without bounds, because resampling until all of 512 coordinates lie in a box never ends.

    It is told an order, never values: CMA-ES uses nothing but ranks, so no number has to stand for a failed design.
    All randomness comes from `rng`; numpy's global generator is neither read nor seeded. The state after n
    generations depends on the arguments and the n orders alone, which is how a run is resumed: tell it again.

    Two ways to start. "best": generation 0 is a sample of the decoder's prior N(0, 1), and its best latent becomes the
    first mean, with step `sigma`; with some hundred evaluations this gets much further. "origin": the first mean is 0,
    which with `sigma` = 1 makes generation 0 the prior too, and the search narrows down from there.

    Args:
        dim: length of a latent.
        popsize: latents per generation, at least 4.
        rng: source of all samples; it is used up by this object alone.
        sigma: first standard deviation s of every coordinate, > 0.
        start: how to find the first mean m.

    Raises:
        ValueError: if an argument is out of its bounds, naming it.
    """

    def __init__(
        self, dim: int, popsize: int, rng: np.random.Generator, *, sigma: float = 1.0, start: Start = "origin"
    ) -> None:
        """Stand before generation 0."""
        if not 2 <= dim <= MAX_DIM:
            raise ValueError(f"dim is {dim}; it must lie in [2, {MAX_DIM}]")
        if popsize < MIN_POPSIZE:
            raise ValueError(f"popsize is {popsize}; it must be at least {MIN_POPSIZE}")
        if not (np.isfinite(sigma) and sigma > 0.0):
            raise ValueError(f"sigma is {sigma}; it must be a finite number above 0")
        if start not in ("best", "origin"):
            raise ValueError(f"start is {start!r}; it must be 'best' or 'origin'")
        self._dim = dim
        self._popsize = popsize
        self._rng = rng
        self._sigma = float(sigma)
        self._generation = 0
        self._asked: list[NDArray[np.float64]] | None = None
        self._es: Any = self._strategy(np.zeros(dim)) if start == "origin" else None

    def _strategy(self, mean: NDArray[np.float64]) -> Any:
        options = {
            "popsize": self._popsize,
            "CMA_diagonal": True,
            # Two-point adaptation tries the last step longer and shorter; cumulation is far slower in 512 dimensions.
            "AdaptSigma": cma.sigma_adaptation.CMAAdaptSigmaTPA,
            "CMA_mirrors": 0,  # mirrored samples would make small populations dependent.
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "seed": np.nan,  # leaves numpy's global generator alone.
            "verbose": -10,  # and below -9 no signals file is looked for in the working directory.
            "verb_log": 0,
            "verb_disp": 0,
        }
        return cma.CMAEvolutionStrategy(mean, self._sigma, options)

    @property
    def dim(self) -> int:
        """Length of a latent."""
        return self._dim

    @property
    def popsize(self) -> int:
        """Latents per generation."""
        return self._popsize

    @property
    def generation(self) -> int:
        """How many generations have been told."""
        return self._generation

    @property
    def sigma(self) -> float:
        """The step size s; of the prior, 1, as long as there is no mean."""
        return 1.0 if self._es is None else float(self._es.sigma)

    @property
    def mean(self) -> NDArray[np.float64]:
        """A copy of the mean m, shape (dim,); of the prior, 0, as long as there is none of the search."""
        return np.zeros(self._dim) if self._es is None else np.array(self._es.mean, np.float64)

    def ask(self) -> NDArray[np.float32]:
        """Sample the next generation, shape (popsize, dim).

        Single precision, so that what is evaluated is what the run file stores.

        Raises:
            RuntimeError: if the last generation has not been told yet.
        """
        if self._asked is not None:
            raise RuntimeError("ask was called twice; tell the order of the last generation first")
        scouts = self._es is None
        self._asked = list(self._rng.standard_normal((self._popsize, self._dim))) if scouts else self._es.ask()
        return np.array(self._asked, np.float32)

    def tell(self, order: Sequence[int]) -> None:
        """Learn from the last generation.

        Args:
            order: indices into what `ask` returned, best first; each exactly once.

        Raises:
            RuntimeError: if nothing was asked.
            ValueError: if it is not a permutation of 0 to popsize - 1.
        """
        if self._asked is None:
            raise RuntimeError("tell was called before ask")
        indices = [int(index) for index in order]
        if len(indices) != self._popsize:
            raise ValueError(f"order has {len(indices)} entries; it must name each of the {self._popsize} latents once")
        if sorted(indices) != list(range(self._popsize)):
            raise ValueError(f"order is {indices}; it must be a permutation of 0 to {self._popsize - 1}")
        asked, self._asked = self._asked, None
        self._generation += 1
        if self._es is None:
            self._es = self._strategy(asked[indices[0]])
            return
        ranks = np.zeros(self._popsize)
        ranks[indices] = np.arange(self._popsize)
        self._es.tell(asked, ranks.tolist())

    def state_digest(self) -> str:
        """Hash everything the future depends on (16 hex digits of SHA-256)."""
        shape = f"{self._dim}/{self._popsize}/{self._sigma!r}/{self._generation}/{self._asked is None}"
        digest = hashlib.sha256(f"cma-es/{shape}".encode())
        if self._es is not None:
            es, step = self._es, self._es.adapt_sigma
            last_mean = es.mean_old if es.countiter else np.nan
            for array in (es.mean, last_mean, es.sigma, es.pc, es.sm.variances, step.s, step.delta):
                digest.update(np.ascontiguousarray(array, "<f8").tobytes())
        digest.update(repr(self._rng.bit_generator.state).encode())
        return digest.hexdigest()[:16]
