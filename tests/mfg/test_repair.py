"""A body that cannot be built is changed as little as helps, and told exactly how."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from bodies import ellipsoid, painted

from decoder.design import Joint, VoxelDesign
from mfg.outcome import Failure, Reason, Stage
from mfg.pipeline import Outcome, score
from mfg.repair import candidates, repaired

JOINT = Joint(np.array([0.32, 0.32, 0.32]), np.array([0.0, 1.0, 0.0]), np.array([-0.6, 0.6]), 1, 2)


@pytest.fixture(scope="module")
def thin() -> VoxelDesign:
    """A torso and an arm too thin for a motor's mount."""
    return painted([ellipsoid((21, 32, 32), (12, 11, 10)), ellipsoid((45, 32, 32), (11, 2.2, 2.2))], (JOINT,))


def test_a_body_that_can_be_built_is_left_alone(hinge: VoxelDesign) -> None:
    found = repaired(score(hinge), score)
    assert found.ok
    assert found.changes == ()
    assert found.tried == 1
    assert found.outcome.design.key == hinge.key


def test_a_thin_arm_is_thickened_where_it_lacks_bone(thin: VoxelDesign) -> None:
    before = score(thin)
    assert before.failure is not None
    assert before.failure.stage is Stage.MOTOR
    found = repaired(score(thin), score)
    assert found.ok
    assert found.changes
    assert found.outcome.design.key == found.changes[-1].design.key
    assert score(found.changes[-1].design).ok
    for change in found.changes:
        assert change.size > 0
        assert "segment" in change.what or "scaled" in change.what


def test_the_smallest_change_that_helps_is_taken(thin: VoxelDesign) -> None:
    outcome = score(thin)
    assert outcome.failure is not None
    found = repaired(outcome, score, rounds=1)
    if found.ok:
        smaller = [c for c in candidates(outcome, outcome.failure) if c.size < found.changes[0].size]
        assert not any(score(c.design).ok for c in smaller)
    else:
        assert not any(score(c.design).ok for c in candidates(outcome, outcome.failure))


def test_touching_segments_are_parted_and_crumbs_dropped() -> None:
    arms = [ellipsoid((45, 32 + s * 7, 32), (10, 8, 8)) for s in (-1, 1)]
    joints = tuple(
        replace(JOINT, position=np.array([0.36, 0.32 + s * 0.08, 0.32]), child=c) for s, c in ((-1, 2), (1, 3))
    )
    body = painted([ellipsoid((22, 32, 32), (13, 13, 12)), *arms], joints)
    outcome = score(body)
    assert outcome.failure is not None
    assert outcome.failure.reason is Reason.CYCLE
    whats = [c.what for c in candidates(outcome, outcome.failure)]
    assert "segments 2 and 3, which touch without a joint, parted" in whats
    parted = next(c for c in candidates(outcome, outcome.failure) if "parted" in c.what)
    after = score(parted.design).failure
    assert after is None or after.reason is not Reason.CYCLE


def test_what_nothing_mends_keeps_its_own_failure(thin: VoxelDesign) -> None:
    def never(design: VoxelDesign) -> Outcome:
        return replace(score(design), failure=Failure(Stage.MOTOR, Reason.NO_OVERLAP, "joint_1: never enough"))

    found = repaired(never(thin), never, rounds=2)
    assert not found.ok
    assert found.changes == ()
    assert found.outcome.design.key == thin.key
    assert str(found.outcome.failure) == "motor: no_overlap (joint_1: never enough)"


def test_a_body_too_large_for_the_printer_shrinks(hinge: VoxelDesign) -> None:
    from decoder.edits import scaled

    by_the_paper = partial(score, rules="paper")  # the search cuts it into pieces instead
    large = scaled(hinge, 1.6)
    outcome = by_the_paper(large)
    assert outcome.failure is not None
    assert outcome.failure.reason is Reason.TOO_LARGE
    found = repaired(outcome, by_the_paper)
    assert all("scaled by 0." in change.what for change in found.changes)


def test_the_given_body_is_not_judged_again(thin: VoxelDesign) -> None:
    judged: list[str] = []

    def judge(design: VoxelDesign) -> Outcome:
        judged.append(design.key)
        return score(design)

    found = repaired(score(thin), judge)
    assert thin.key not in judged
    assert found.tried == len(judged) + 1


def test_only_what_the_miss_blames_grows_and_its_words_do_not_matter(thin: VoxelDesign) -> None:
    outcome = score(thin)
    assert outcome.failure is not None
    assert outcome.failure.miss is not None
    assert outcome.failure.miss.joints == (0,)
    renamed = replace(outcome.failure, detail="something else")
    told = [change.what for change in candidates(outcome, outcome.failure)]
    assert told == [change.what for change in candidates(outcome, renamed)]
    assert any("near joint_1" in what for what in told)
    blind = [change.what for change in candidates(outcome, replace(outcome.failure, miss=None))]
    assert blind
    assert all("scaled" in what for what in blind)
    body = replace(outcome.failure.miss, joints=(), bodies=(1,))
    grown = [change.what for change in candidates(outcome, replace(outcome.failure, miss=body))]
    assert {what for what in grown if "scaled" not in what} == {
        f"segment 2 (body_1) thicker by {k} voxel(s) all over" for k in (1, 2, 3)
    }
