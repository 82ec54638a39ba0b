"""A miss rides along with a failure without changing how it reads, and says where and how much without its words."""

from __future__ import annotations

import pickle
from typing import get_args

import numpy as np
import pytest

from decoder.edits import scaled
from decoder.latent import make_decoder, sample_latents
from mfg.miss import Miss, Remedy, Unit
from mfg.outcome import Failure, Reason, Stage
from mfg.pipeline import Outcome, score


def test_a_miss_is_invisible_to_people_and_to_comparison() -> None:
    miss = Miss("shared volume", "m3", 6e-7, 1e-6, (1,), (2,), remedy="grow_near_joint")
    plain, told = (Failure(Stage.MOTOR, Reason.NO_OVERLAP, "joint_2", m) for m in (None, miss))
    assert str(plain) == str(told)
    assert repr(plain) == repr(told)
    assert plain == told
    assert hash(plain) == hash(told)
    assert Failure(Stage.MOTOR, Reason.NO_OVERLAP, "joint_2").miss is None


def test_a_miss_crosses_processes() -> None:
    failure = Failure(Stage.MOTOR, Reason.WEAK_MOUNT, "joint_1", Miss("safety factor", "1", 1.0, 2.0, (0,)))
    assert pickle.loads(pickle.dumps(failure)).miss == failure.miss


def test_shortfall_is_how_far_apart_have_and_need_are() -> None:
    assert Miss("safety factor", "1", 1.5, 2.0).shortfall == 0.5
    assert Miss("length of a cable", "m", 1.75, 1.5).shortfall == 0.25
    assert Miss("room for a cable", "m").shortfall == 0.0
    assert Miss("safety factor", "1", None, 2.0).shortfall == 0.0


@pytest.fixture(scope="module")
def refused() -> list[Outcome]:
    """Small bodies that some rules refuse, their tree being sound."""
    latents = sample_latents(8, np.random.default_rng(5))
    shrunk = [scaled(design, factor) for design in make_decoder("genome").decode(latents) for factor in (0.8, 0.65)]
    outcomes = [score(design, rules=rules) for design in shrunk for rules in ("paper", "search")]  # type: ignore[arg-type]
    found = [outcome for outcome in outcomes if not outcome.ok and outcome.blueprint.tree is not None]
    stages = {outcome.failure.stage for outcome in found if outcome.failure}
    assert stages >= {Stage.SKELETON, Stage.MOTOR, Stage.ELECTRONICS}
    return found


def test_every_failure_of_a_sound_tree_says_where_and_how_much(refused: list[Outcome]) -> None:
    for outcome in refused:
        failure, blueprint = outcome.failure, outcome.blueprint
        assert failure is not None
        miss = failure.miss
        assert miss is not None, failure
        assert miss.joints or miss.bodies
        assert all(0 <= joint < len(blueprint.hinges) for joint in miss.joints)
        assert blueprint.tree is not None
        assert all(0 <= body < len(blueprint.tree.segments) for body in miss.bodies)
        assert miss.unit in get_args(Unit)
        assert miss.remedy in get_args(Remedy)
        assert miss.grow >= 0.0
        if miss.have is not None and miss.need is not None and miss.remedy != "clear_way":
            assert miss.have < miss.need, failure
        if miss.direction is not None:
            assert np.linalg.norm(miss.direction) == pytest.approx(1.0)


def test_what_a_miss_blames_is_what_the_words_name(refused: list[Outcome]) -> None:
    for outcome in refused:
        failure = outcome.failure
        assert failure is not None
        assert failure.miss is not None
        hinges, bodies = outcome.blueprint.hinges, outcome.blueprint.bodies
        if failure.stage is Stage.MOTOR:
            assert all(hinges[joint].name in failure.detail for joint in failure.miss.joints)
        if failure.stage is Stage.ELECTRONICS:
            assert all(bodies[body].name in failure.detail for body in failure.miss.bodies)
