from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from evo.cma_es import CmaEs


def strategy(seed: int = 0, dim: int = 6, popsize: int = 8, **options: object) -> CmaEs:
    return CmaEs(dim, popsize, np.random.default_rng(seed), **options)  # type: ignore[arg-type]


def sphere_order(latents: NDArray[np.float32], target: float = 2.0) -> list[int]:
    return [int(i) for i in np.argsort(np.square(latents - target).sum(1), kind="stable")]


@pytest.mark.parametrize("options", [{"start": "origin"}, {"start": "best", "sigma": 0.3}])
def test_generation_0_is_the_prior(options: dict[str, object]) -> None:
    latents = strategy(dim=512, popsize=400, **options).ask()
    assert latents.shape == (400, 512)
    assert latents.dtype == np.float32
    # 204 800 draws: five standard errors of the mean, the deviation and the fourth moment (3 for a normal law).
    assert abs(latents.mean()) < 5 / np.sqrt(latents.size)
    assert abs(latents.std() - 1) < 5 / np.sqrt(2 * latents.size)
    assert abs((latents.astype(float) ** 4).mean() - 3) < 5 * np.sqrt(96 / latents.size)


def test_the_best_of_generation_0_is_where_the_search_starts() -> None:
    es = strategy(dim=512, popsize=40, start="best", sigma=0.25)
    scouts = es.ask()
    es.tell([17, *(i for i in range(40) if i != 17)])
    assert (es.mean.astype(np.float32) == scouts[17]).all()
    assert es.sigma == 0.25
    steps = es.ask() - scouts[17]
    assert abs(steps.std() / 0.25 - 1) < 5 / np.sqrt(2 * steps.size)


@pytest.mark.parametrize("start", ["origin", "best"])
def test_it_finds_an_optimum_from_orders_alone(start: str) -> None:
    es = strategy(dim=20, popsize=10, start=start)
    for _ in range(150):
        es.tell(sphere_order(es.ask()))
    assert np.abs(es.mean - 2.0).max() < 0.05
    assert es.sigma < 0.1


@pytest.mark.parametrize("start", ["origin", "best"])
@pytest.mark.parametrize("dim", [6, 512])
def test_the_state_follows_from_seed_and_orders(dim: int, start: str) -> None:
    first, second = strategy(dim=dim, start=start), strategy(dim=dim, start=start)
    assert first.state_digest() == second.state_digest()
    digests = [first.state_digest()]
    for _ in range(6):
        order = sphere_order(first.ask())
        first.tell(order)
        assert second.ask() is not None
        second.tell(order)
        assert first.state_digest() == second.state_digest()
        digests.append(first.state_digest())
    assert len(set(digests)) == len(digests)
    assert (first.ask() == second.ask()).all()


def test_another_order_or_another_seed_is_another_state() -> None:
    def after(seed: int, reverse: bool) -> str:
        es = strategy(seed)
        order = sphere_order(es.ask())
        es.tell(order[::-1] if reverse else order)
        return es.state_digest()

    assert len({after(0, False), after(0, True), after(1, False)}) == 3


def test_numpy_s_global_generator_is_neither_read_nor_seeded() -> None:
    def run() -> str:
        es = strategy(dim=400)
        for _ in range(3):
            es.tell(sphere_order(es.ask()))
        return es.state_digest()

    before = np.random.get_state(legacy=False)  # noqa: NPY002 - the one that must not change.
    digest = run()
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    assert repr(before) == repr(after)
    np.random.standard_normal(7)  # noqa: NPY002
    assert run() == digest


def test_asking_and_telling_take_turns() -> None:
    es = strategy()
    with pytest.raises(RuntimeError, match="before ask"):
        es.tell(range(8))
    es.ask()
    with pytest.raises(RuntimeError, match="twice"):
        es.ask()
    es.tell(range(8))
    assert es.generation == 1
    with pytest.raises(RuntimeError, match="before ask"):
        es.tell(range(8))


@given(st.lists(st.integers(-1, 9), max_size=10).filter(lambda order: sorted(order) != list(range(8))))
def test_an_order_that_is_no_permutation_is_refused_and_changes_nothing(order: list[int]) -> None:
    es = strategy()
    es.ask()
    before = es.state_digest()
    with pytest.raises(ValueError, match="order"):
        es.tell(order)
    assert es.state_digest() == before
    es.tell(range(8))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"dim": 1}, "dim is 1"),
        ({"popsize": 3}, "popsize is 3"),
        ({"sigma": 0.0}, "sigma is 0.0"),
        ({"sigma": float("nan")}, "sigma is nan"),
        ({"start": "middle"}, "start is 'middle'"),
    ],
)
def test_arguments_are_checked(options: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        strategy(**options)  # type: ignore[arg-type]
