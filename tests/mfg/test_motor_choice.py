"""Choosing seats together equals trying every combination; clearances bound the exact distance."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from mfg.exact import surface_points
from mfg.fields import cylinder_distance
from mfg.motor_choice import Clearance, Stuck, choose
from mfg.motors import envelopes_meet
from mfg.mounts import envelope, motor_pose, mount_of
from mfg.parts import J60_6

MOUNT = mount_of(J60_6)


def brute_force(
    scores: list[NDArray[np.float64]], apart: dict[tuple[int, int], NDArray[np.bool_]], good: list[NDArray[np.bool_]]
) -> float | None:
    sums = [
        sum(float(s[a]) for s, a in zip(scores, pick, strict=True))
        for pick in itertools.product(*[range(len(s)) for s in scores])
        if all(good[i][a] for i, a in enumerate(pick)) and all(apart[i, j][pick[i], pick[j]] for i, j in apart)
    ]
    return max(sums, default=None)


@pytest.mark.parametrize("seed", range(40))
def test_the_choice_is_the_best_of_all_combinations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 7, rng.integers(1, 5)).tolist()
    scores = [np.sort(rng.random(n))[::-1] for n in sizes]
    density = rng.choice([0.25, 0.5, 0.8])
    apart = {(i, j): rng.random((sizes[i], sizes[j])) < density for j in range(len(sizes)) for i in range(j)}
    certain = {key: table | (rng.random(table.shape) < 0.5) for key, table in apart.items()}
    good = [rng.random(n) < 0.7 for n in sizes]
    answer = choose(
        scores,
        lambda i, a, j: certain[i, j][a],
        lambda i, a, j, b: bool(apart[i, j][a, b]),
        lambda i, a: bool(good[i][a]),
        steps=10**6,
    )
    best = brute_force(scores, apart, good)
    if best is None:
        assert isinstance(answer, Stuck)
        assert answer.other is None or answer.other != answer.joint
    else:
        assert not isinstance(answer, Stuck)
        assert sum(float(s[a]) for s, a in zip(scores, answer, strict=True)) == pytest.approx(best)
        assert all(good[i][a] for i, a in enumerate(answer))
        assert all(table[answer[i], answer[j]] for (i, j), table in apart.items())


def test_a_joint_without_any_good_candidate_is_named() -> None:
    scores = [np.array([3.0, 2.0]), np.array([5.0, 4.0, 1.0])]
    answer = choose(
        scores, lambda *at: np.ones(len(scores[at[2]]), bool), lambda *_: True, lambda *at: at[0] == 0, steps=1000
    )
    assert answer == Stuck(1, None)


def test_few_steps_end_the_search() -> None:
    asked = []
    n = 30
    scores = [np.linspace(2, 1, n)] * 5

    def accept(i: int, a: int) -> bool:
        asked.append((i, a))
        return True

    answer = choose(scores, lambda *_: np.ones(n, bool), lambda *_: False, accept, steps=200)
    assert isinstance(answer, Stuck)
    assert not asked


@pytest.mark.parametrize("seed", range(30))
def test_clearance_never_claims_more_than_is_true(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(8, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    T = motor_pose(np.zeros(3), axes[0], 0.0)
    U = np.array([motor_pose(rng.uniform(-0.12, 0.12, 3), a, 0.0) for a in axes[1:]])
    found = Clearance.of(T[None], U, MOUNT)
    one = envelope(MOUNT, 0.0).moved(T)
    for k, other in enumerate(U):
        shared = one.overlap(envelope(MOUNT, 0.0).moved(other))
        if found.distance[0, k] > 0:
            assert shared == 0.0
            assert not envelopes_meet(T, other, MOUNT, float(found.distance[0, k]) / np.sqrt(2))
            assert not found.meet[0, k]
            points = surface_points(envelope(MOUNT, 0.0), 4e-3) @ T[:3, :3].T + T[:3, 3]
            rest = cylinder_distance(points, other, MOUNT.envelope_radius, MOUNT.base_low, MOUNT.connector_high)
            assert rest.min() >= found.distance[0, k] - 1e-9
        if found.meet[0, k]:
            assert shared > 0.0


@pytest.mark.parametrize("angle", [1e-8, 2e-8, 1e-7, 1e-6, 1e-4])
def test_nearly_parallel_motors_are_as_far_apart_as_parallel_ones(angle: float) -> None:
    rng = np.random.default_rng(0)
    T = motor_pose(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.0)
    for turn in rng.uniform(0, 2 * np.pi, 40):
        lean = np.array([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
        at = rng.uniform(-0.12, 0.12, 3)
        found, exact = (Clearance.of(T[None], motor_pose(at, axis, 0.0)[None], MOUNT).distance[0, 0]
                        for axis in (lean, T[:3, 2]))  # fmt: skip
        assert found == pytest.approx(exact, abs=0.5 * angle + 1e-8)


def test_a_block_of_clearances_is_that_of_its_rows() -> None:
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(12, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    poses = np.array([motor_pose(rng.uniform(-0.1, 0.1, 3), axis, 0.0) for axis in axes])
    block = Clearance.of(poses[:5], poses[5:], MOUNT)
    for k in range(5):
        row = Clearance.of(poses[k : k + 1], poses[5:], MOUNT)
        np.testing.assert_array_equal(block.distance[k], row.distance[0])
        np.testing.assert_array_equal(block.meet[k], row.meet[0])
    assert 0 < block.meet.sum() < block.meet.size


def test_clearance_of_parallel_motors_is_exact() -> None:
    reach = 2 * MOUNT.envelope_radius
    T, U = np.eye(4), np.eye(4)
    U[0, 3] = reach + 0.013
    assert Clearance.of(T[None], U[None], MOUNT).distance[0, 0] == pytest.approx(0.013)
    U[:3, 3] = 0.0, 0.0, MOUNT.connector_high - MOUNT.base_low + 0.004
    assert Clearance.of(T[None], U[None], MOUNT).distance[0, 0] == pytest.approx(0.004)
