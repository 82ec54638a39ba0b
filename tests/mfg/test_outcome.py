"""The vocabulary: scores add up, and every stage appears once in the order in which a design meets it."""

from __future__ import annotations

import pytest

from mfg.outcome import Failure, Reason, Scores, Stage


def test_the_total_is_the_sum_of_what_was_reached() -> None:
    assert Scores().total == 0.0
    assert Scores(motor=0.5, body_install=0.25).total == 0.75
    assert Scores(1, 1, 1, 1, 1).total == 5.0
    assert Scores(motor=0.3).values() == (0.3, None, None, None, None)


def test_stage_names_are_the_contract() -> None:
    assert [str(s) for s in Stage] == ["skeleton", "motor", "electronics", "wire", "print", "worker"]


def test_a_failure_reads_as_one_line() -> None:
    failure = Failure(Stage.MOTOR, Reason.NO_OVERLAP, "joint_1: 0.8 cm3 of 1.2 cm3")
    assert str(failure) == "motor: no_overlap (joint_1: 0.8 cm3 of 1.2 cm3)"
    with pytest.raises(AttributeError):
        failure.detail = "other"  # type: ignore[misc]
