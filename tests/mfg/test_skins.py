"""Skins: tissue goes to the nearest bone, leaves the joints free and never enters another body."""

from __future__ import annotations

import numpy as np
from bodies import ellipsoid, painted

from decoder.design import VoxelDesign
from mfg.blueprint import Blueprint
from mfg.parts import PAPER
from mfg.pipeline import VIRTUAL, virtual
from mfg.skins import SkinSolver, soft_owner
from mfg.solids import from_field


def test_orphan_tissue_belongs_to_the_nearest_bone(creature: VoxelDesign) -> None:
    owner = soft_owner(creature)
    bones = {s: np.argwhere((creature.segment == s) & (creature.material == 2)) for s in creature.segments}
    rng = np.random.default_rng(0)
    soft = np.argwhere(creature.material == 1)
    for voxel in soft[rng.choice(len(soft), 60, replace=False)]:
        distance = {s: np.linalg.norm(b - voxel, axis=1).min() for s, b in bones.items()}
        assert distance[int(owner[tuple(voxel)])] == min(distance.values())


def test_tissue_keeps_clear_of_joints_and_of_other_bodies(creature: VoxelDesign) -> None:
    outcome = virtual(creature)
    assert outcome.ok, outcome.failure
    bodies = outcome.blueprint.bodies
    bones = [from_field(b.bone) for b in bodies]
    outer = [from_field(b.skin) for b in bodies if b.skin is not None]
    assert len(outer) == 3
    for i, a in enumerate(outer):
        assert (bones[i] - a).volume < 1e-3 * bones[i].volume  # A skin wraps its own bone,
        for j in range(i):
            assert a.overlap(outer[j]) < 1e-9  # and never enters another body.
            assert a.overlap(bones[j]) < 1e-9
    for joint in creature.joints:
        for body in bodies:
            assert body.skin is not None
            near = np.linalg.norm(body.skin.points() - joint.position, axis=-1) < SkinSolver().joint_clearance - 0.015
            flesh = (body.skin.values > 0) & (body.bone.on_lattice_of(body.skin) < -0.003)
            assert not (near & flesh).any()


def test_a_body_without_soft_voxels_has_no_skin(elbow: VoxelDesign) -> None:
    outcome = virtual(elbow)
    assert outcome.ok
    assert all(body.skin is None for body in outcome.blueprint.bodies)


def test_a_whisker_is_opened_away() -> None:
    bones = [ellipsoid((22, 32, 32), (9, 6, 6)), ellipsoid((42, 32, 32), (9, 6, 6))]
    soft = np.zeros((64, 64, 64), bool)
    soft[20, 32, 38:55] = True
    from decoder.design import Joint

    joint = Joint((0.32, 0.32, 0.32), (0, 1, 0), (-1, 1), 1, 2)
    outcome = virtual(painted(bones, (joint,), soft))
    assert outcome.ok
    assert all(body.skin is None for body in outcome.blueprint.bodies)


def test_solvers_are_pure(creature: VoxelDesign) -> None:
    blueprint = Blueprint(creature, PAPER)
    for solver in VIRTUAL:
        first, second = solver.solve(blueprint), solver.solve(blueprint)
        assert isinstance(first, Blueprint)
        assert isinstance(second, Blueprint)
        for a, b in zip(first.bodies, second.bodies, strict=True):
            np.testing.assert_array_equal(a.bone.values, b.bone.values)
        blueprint = first
