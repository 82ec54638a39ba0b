"""The synthetic bodies: legal designs, bends within bounds, mirror images, and the same draw twice."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from decoder.design import Material
from decoder.examples import examples, seen
from decoder.features import features
from decoder.formulas import Bodies, field
from decoder.kinematics import is_one_tree, tree_shape
from decoder.networks import decode, distances, encode, initial, velocity
from decoder.synthetic import generator, sample_bodies, sample_designs
from decoder.trees import all_trees


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    return sample_bodies(256, generator(1, 0))


def test_every_tree_has_carriers_before_the_carried_and_twins_of_equal_rank():
    trees = all_trees()
    assert trees.odds.sum() == pytest.approx(1.0)
    for row in range(len(trees.odds)):
        count = trees.count[row]
        assert 3 <= count <= 8
        assert (trees.parent[row, 1:count] < np.arange(1, count)).all()
        assert (trees.parent[row, count:] == -1).all()
        for k in range(1, count):
            twin = trees.twin[row, k]
            assert twin < k
            if twin >= 0 and trees.parent[row, k]:
                # The carrier of an image is the image of the carrier, or both hang on one in the mirror plane.
                carrier, original = trees.parent[row, k], trees.parent[row, twin]
                assert trees.twin[row, carrier] == original or (carrier == original and trees.planar[row, carrier])


def test_the_trees_have_all_counts_and_more_than_thirty_shapes():
    trees = all_trees()
    shapes = set()
    for row in range(len(trees.odds)):
        links = [(int(trees.parent[row, k]), k) for k in range(1, trees.count[row])]
        degrees = tuple(sorted(sum(k in link for link in links) for k in range(trees.count[row])))
        shapes.add((int(trees.count[row]), degrees))
    assert set(trees.count) == {3, 4, 5, 6, 7, 8}
    assert len(shapes) >= 17  # Degree sequences alone; trees that differ in more are not counted here.


def test_hinges_lie_across_their_limbs_and_their_axes_have_unit_length(bodies: Bodies):
    alive = bodies.alive.clone()
    alive[:, 0] = False
    axis, along = bodies.axis[alive], bodies.frame[..., 2][alive]
    assert torch.allclose(axis.norm(dim=1), torch.ones(len(axis)), atol=1e-5)
    assert (axis * along).sum(1).abs().max() < 1e-4
    assert (bodies.range[..., 0] < -0.49).all()
    assert (bodies.range[..., 1] > 0.49).all()


def test_limbs_bend_by_15_to_90_degrees_beyond_the_hips(bodies: Bodies):
    along = bodies.frame[..., 2]
    rows = torch.arange(len(bodies))[:, None]
    siblings = torch.zeros(len(bodies), 8)
    siblings.scatter_add_(1, bodies.parent, bodies.alive.float())
    chain = bodies.alive & (bodies.parent > 0) & (siblings[rows, bodies.parent] == 1)
    angle = torch.rad2deg(torch.acos((along * along[rows, bodies.parent]).sum(2).clamp(-1, 1)))[chain]
    assert len(angle) > 100
    assert angle.min() > 14.0
    assert angle.max() < 91.0


def test_a_symmetric_body_is_its_own_mirror_image():
    found = 0
    for design in sample_designs(24, 11):
        rigid = design.material == Material.RIGID
        mirrored = rigid[:, ::-1]
        overlap = (rigid & mirrored).sum() / (rigid | mirrored).sum()
        found += overlap > 0.97
    assert 5 <= found <= 19


def test_designs_are_trees_within_the_margin_and_drawn_alike_again():
    first, again = sample_designs(6, 3), sample_designs(4, 3)
    assert [d.key for d in first[:4]] == [d.key for d in again]
    for design in first:
        assert is_one_tree(design)
        assert design.depth is not None
        filled = np.argwhere(design.material > 0)
        assert filled.min() >= 2
        assert filled.max() <= 61
    assert len({tree_shape(d) for d in first}) > 1


def test_the_field_of_a_round_torso_is_its_distance(bodies: Bodies):
    ball = bodies.pick(torch.tensor([0]), torch.tensor([0]))
    values = {name: getattr(ball, name).clone() for name in Bodies.__dataclass_fields__}
    values["half"][:] = 6.0
    values["exponent"][:] = 2.0
    values["blobs"][:] = 0.0
    values["bone_form"][:] = 0.0
    values["skin_form"][:] = 0.0
    values["thickness"][:] = 2.5
    points = values["start"][:, None] + torch.randn(1, 500, 3, generator=generator(0, 0)) * 5.0
    bone, skin = field(Bodies(**values), points)
    distance = (points - values["start"][:, None]).norm(dim=2)
    assert torch.allclose(bone, distance - 6.0, atol=1e-3)
    assert torch.allclose(skin, distance - 8.5, atol=1e-3)


def test_a_design_is_seen_as_the_formulas_of_its_body_say():
    differing, pose, lattices = 0, [], []
    for k in range(12):
        design = sample_designs(k + 1, 7)[k] if k < 3 else sample_designs(1, 100 + k)[0]
        drawn = sample_bodies(1, generator(7, k) if k < 3 else generator(100 + k, 0))
        alive, wanted_lattices, wanted_pose = (t.numpy() for t in seen(examples(drawn)))
        found = features(design)
        assert np.array_equal(found.alive, alive[0])
        if not np.array_equal(found.pose[:, :9], wanted_pose[0, :, :9]):
            differing += 1  # Two siblings at nearly the same azimuth may change places.
            continue
        pose.append(found.pose - wanted_pose[0])
        lattices.append(found.lattices - wanted_lattices)
    assert differing <= 2
    assert np.sqrt(np.mean(np.square(pose))) < 0.03
    assert np.abs(np.mean(pose, axis=(0, 1))).max() < 0.03
    assert np.abs(np.concatenate(lattices)).mean() < 0.03


def test_examples_do_not_depend_on_who_is_beside_them():
    drawn = sample_bodies(5, generator(4, 0))
    together = examples(drawn)
    alone = examples(drawn.pick(torch.tensor([2])))
    assert torch.equal(together.parent[2], alone.parent[0])
    assert torch.allclose(together.pose[2], alone.pose[0], atol=1e-4)
    before = int(together.alive[:2].sum())
    mine = slice(before, before + int(together.alive[2].sum()))
    assert torch.allclose(together.distance[mine], alone.distance, atol=1e-3)
    assert torch.allclose(together.occupancy[mine], alone.occupancy, atol=1e-3)


def test_numpy_and_torch_give_the_same_numbers():
    rng = np.random.default_rng(0)
    arrays = initial(rng)
    arrays["flow.out"] = 0.03 * rng.standard_normal(arrays["flow.out"].shape).astype(np.float32)
    alive, lattices, pose = seen(examples(sample_bodies(3, generator(9, 0))))
    mean, spread = encode(arrays, alive.numpy(), lattices.numpy(), pose.numpy(), np)
    tensors = {name: torch.tensor(array) for name, array in arrays.items()}
    other, width = encode(tensors, alive, lattices, pose, torch)
    assert np.abs(mean - other.numpy()).max() < 1e-3
    assert np.abs(spread - width.numpy()).max() < 1e-3
    assert math.isfinite(float(np.abs(mean).max()))
    said, tokens = decode(arrays, mean, np)
    again, others = decode(tensors, torch.tensor(mean), torch)
    assert np.abs(said - again.numpy()).max() < 1e-3
    near = distances(arrays, tokens, alive.numpy(), np)
    assert near.shape == (int(alive.sum()), 4608)
    assert np.abs(near - distances(tensors, others, alive, torch).numpy()).max() < 1e-3
    time = np.full((3, 1), 0.3, np.float32)
    flow = velocity(arrays, mean, time, np)
    assert np.abs(flow).max() > 0.1
    assert np.abs(flow - velocity(tensors, torch.tensor(mean), torch.tensor(time), torch).numpy()).max() < 1e-3
