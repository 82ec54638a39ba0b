"""A miss rides along with a failure without changing how it reads, compares or is written."""

from __future__ import annotations

import pickle

from mfg.miss import Miss
from mfg.outcome import Failure, Reason, Stage


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
