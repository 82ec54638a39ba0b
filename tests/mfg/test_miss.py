"""A miss rides along with a failure without changing how it reads, compares or is written."""

from __future__ import annotations

import pickle

from mfg.miss import Miss
from mfg.outcome import Failure, Reason, Stage


def test_a_miss_is_invisible_to_people_and_to_comparison() -> None:
    miss = Miss(Stage.MOTOR, joint=1, body=2, segment=3, short_volume=4e-7, remedy="grow_near_joint")
    plain, told = (Failure(Stage.MOTOR, Reason.NO_OVERLAP, "joint_2", m) for m in (None, miss))
    assert str(plain) == str(told)
    assert repr(plain) == repr(told)
    assert plain == told
    assert hash(plain) == hash(told)
    assert Failure(Stage.MOTOR, Reason.NO_OVERLAP, "joint_2").miss is None


def test_a_miss_crosses_processes() -> None:
    failure = Failure(Stage.MOTOR, Reason.WEAK_MOUNT, "joint_1", Miss(Stage.MOTOR, joint=0, short_factor=0.5))
    assert pickle.loads(pickle.dumps(failure)).miss == failure.miss
