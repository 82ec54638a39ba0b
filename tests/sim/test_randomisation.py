"""Robots that are drawn lie in their ranges, are the same for the same seed, and change what they say they change."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mfg.description import Description
from sim.herd import Herd, with_latency_room
from sim.model import DAMPING, FLOOR, STIFFNESS, VOLTAGE, Model, compile_model, make_spec
from sim.randomisation import (
    EXACT,
    RANDOMISED,
    WIDE,
    Draws,
    Randomisation,
    apply,
    corners,
    draw,
    joined,
    nominal,
    push,
    pushed,
)
from sim.rollout import settle
from sim.skin import Fidelity


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Model:
    return with_latency_room(make_spec(quadruped))


def drawn(ranges: Randomisation = RANDOMISED, seed: int = 0, count: int = 2000) -> Draws:
    return draw(ranges, np.random.default_rng(seed), count, 4, 5)


def arrays(draws: Draws) -> dict[str, np.ndarray]:
    values = {field.name: getattr(draws, field.name) for field in fields(draws)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


FACTORS = ("stiffness", "damping", "voltage", "friction", "contact_time", "mass", "skin")


@pytest.mark.parametrize("name", FACTORS)
def test_a_factor_lies_in_its_range_and_its_logarithm_is_uniform(name: str) -> None:
    low, high = getattr(RANDOMISED, name)
    value = arrays(drawn())[name]
    assert value.min() >= low
    assert value.max() <= high
    flat = value.reshape(len(value), -1)[:, 0]
    assert_allclose(np.log(flat).mean(), (np.log(low) + np.log(high)) / 2, atol=0.03 * np.log(high / low))
    assert_allclose(np.log(flat).std(), np.log(high / low) / np.sqrt(12), rtol=0.05)
    if name in ("stiffness", "damping"):  # one battery and one firmware: all motors of a robot alike
        assert (value == value[:, :1]).all()
    if name == "mass":
        assert np.abs(np.corrcoef(value.T) - np.eye(5)).max() < 0.1


def test_what_is_added_is_centred_and_within_its_bound() -> None:
    draws = drawn()
    for value, bound in ((draws.gyro_bias, RANDOMISED.gyro_bias), (draws.encoder_offset, RANDOMISED.encoder_offset)):
        assert np.abs(value).max() <= bound
        assert np.abs(value.mean(axis=0)).max() < 0.1 * bound
        assert_allclose(value.std(axis=0), bound / np.sqrt(3), rtol=0.06)
    assert draws.latency is not None
    assert 0.0 <= draws.latency.min() < 0.001
    assert 0.039 < draws.latency.max() <= 0.04


def test_training_draws_robots_with_less_noise_and_what_is_claimed_has_all_of_it() -> None:
    assert (arrays(drawn())["noise_level"] == 1.0).all()
    level = arrays(drawn(WIDE))["noise_level"]
    assert 0.0 <= level.min() < 0.01
    assert 0.99 < level.max() <= 1.0
    assert_allclose(level.mean(), 0.5, atol=0.03)
    with pytest.raises(ValueError, match=r"noise_level is \(-0.1, 1.0\); it must be a range with 0 <= low"):
        replace(WIDE, noise_level=(-0.1, 1.0))


def test_a_crooked_imu_is_turned_by_no_more_than_it_may() -> None:
    turn = drawn().imu_turn
    assert_allclose(np.einsum("kij,klj->kil", turn, turn), np.tile(np.eye(3), (2000, 1, 1)), atol=1e-12)
    assert_allclose(np.linalg.det(turn), 1.0)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert angle.max() <= RANDOMISED.imu_turn * np.sqrt(3) + 1e-9
    assert angle.max() > RANDOMISED.imu_turn


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_the_same_generator_draws_the_same_bytes(seed: int, count: int) -> None:
    one, two = arrays(drawn(WIDE, seed=seed, count=count)), arrays(drawn(WIDE, seed=seed, count=count))
    assert {k: v.tobytes() for k, v in one.items()} == {k: v.tobytes() for k, v in two.items()}
    other = arrays(drawn(WIDE, seed=seed + 1, count=count))
    assert all(other[name].tobytes() != value.tobytes() for name, value in one.items())
    for name, value in one.items():
        assert len(value) == count, name


def test_rows_are_taken_over_from_another_draw() -> None:
    mine, theirs, ids = drawn(count=5), drawn(seed=1, count=2), np.array([3, 0])
    kept = {name: value.copy() for name, value in arrays(mine).items()}
    both = arrays(mine.changed(ids, theirs))
    for name, value in arrays(mine).items():
        assert value.tobytes() == kept[name].tobytes(), name
        assert both[name][ids].tobytes() == arrays(theirs)[name].tobytes(), name
        assert both[name][[1, 2, 4]].tobytes() == value[[1, 2, 4]].tobytes(), name


def test_masses_and_inertias_are_scaled_and_so_is_the_whole(model: Model) -> None:
    herd, draws = Herd(model, 3), drawn(count=3)
    apply(herd, np.arange(3), draws)
    assert draws.mass is not None
    for copy in range(3):
        ours = herd.batch.get_model(copy)
        assert_allclose(ours.body_mass[1:], model.body_mass[1:] * draws.mass[copy])
        assert_allclose(ours.body_inertia[1:], model.body_inertia[1:] * draws.mass[copy][:, None])
        assert_allclose(ours.body_subtreemass[1], (model.body_mass[1:] * draws.mass[copy]).sum())
        assert abs(ours.body_subtreemass[1] / model.body_subtreemass[1] - 1) > 1e-3
        # What MuJoCo derives from masses follows: a heavier root is harder to move.
        data, plain = mujoco.MjData(ours), mujoco.MjData(model)
        mujoco.mj_forward(ours, data)
        mujoco.mj_forward(model, plain)
        assert_allclose(ours.body_invweight0[1, 0] / model.body_invweight0[1, 0], 1.0, rtol=0.25)
        assert ours.body_invweight0[1, 0] != model.body_invweight0[1, 0]
    # The model that it was made of stays as it is.
    assert_allclose(model.body_mass.sum(), model.body_subtreemass[1])


def test_motors_ground_and_latency_are_those_drawn(model: Model) -> None:
    herd, draws = Herd(model, 4), drawn(count=2)
    plain = model.actuator_gainprm.copy()
    apply(herd, np.array([1, 3]), draws)
    for row, copy in enumerate((1, 3)):
        ours = herd.batch.get_model(copy)
        assert draws.stiffness is not None
        assert_allclose(ours.actuator_gainprm[:, STIFFNESS], plain[:, STIFFNESS] * draws.stiffness[row])
        assert_allclose(ours.actuator_gainprm[:, DAMPING], plain[:, DAMPING] * draws.damping[row])  # type: ignore[index]
        assert_allclose(ours.actuator_gainprm[:, VOLTAGE], plain[:, VOLTAGE] * draws.voltage[row])  # type: ignore[index]
        assert_allclose(ours.geom_friction[:, 0], draws.friction[row])  # type: ignore[index]
        assert_allclose(ours.geom_friction[:, 1:], model.geom_friction[:, 1:])
        wanted = model.geom_solref[:, 0] * draws.contact_time[row]  # type: ignore[index]
        assert_allclose(ours.geom_solref[:, 0], wanted)
        assert_allclose(ours.actuator_delay, max(draws.latency[row], model.opt.timestep))  # type: ignore[index]
    for copy in (0, 2):  # they were not asked for
        ours = herd.batch.get_model(copy)
        for field in ("actuator_gainprm", "geom_friction", "geom_solref", "actuator_delay", "body_mass"):
            assert_allclose(getattr(ours, field), getattr(model, field), err_msg=field)
    assert_allclose(model.actuator_gainprm, plain)


def test_skins_of_finite_elements_get_the_friction_that_was_drawn(quadruped: Description) -> None:
    soft = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    model = compile_model(replace(quadruped, links=soft), fidelity=Fidelity.FLEX)
    assert model.nflex
    herd = Herd(model, 2)
    changes = {"friction": np.array([0.4, 1.2]), "contact_time": np.array([0.5, 1.5])}
    apply(herd, np.arange(2), replace(nominal(2, 4), **changes))
    for copy, friction, factor in ((0, 0.4, 0.5), (1, 1.2, 1.5)):
        ours = herd.batch.get_model(copy)
        assert_allclose([*ours.geom_friction[:, 0], *ours.flex_friction[:, 0]], friction)
        assert_allclose(ours.flex_solref[:, 0], model.flex_solref[:, 0] * factor)


def test_less_friction_slides_further(model: Model) -> None:
    herd = Herd(model, 2)
    apply(herd, np.arange(2), replace(nominal(2, 4), friction=np.array([0.2, 1.0])))
    herd.place(np.arange(2), np.repeat(settle(model)[None], 2, axis=0))
    herd.qvel[:, 0] = 0.5
    herd.refresh(np.arange(2))
    for _ in range(40):
        herd.advance(np.zeros((2, 4)))
    assert herd.qpos[0, 0] > 1.5 * herd.qpos[1, 0]
    assert model.geom(FLOOR).friction[0] == pytest.approx(0.8)


def test_the_robot_of_the_model_is_drawn_exactly(model: Model) -> None:
    draws = drawn(EXACT, count=3)
    herd, plain = Herd(model, 3), Herd(model, 3)
    apply(herd, np.arange(3), draws)
    start = np.repeat(settle(model)[None], 3, axis=0)
    for one in (herd, plain):
        one.place(np.arange(3), start)
        for k in range(10):
            one.advance(np.full((3, 4), 0.05 * k))
    assert_allclose(herd.qpos, plain.qpos, rtol=0, atol=1e-6)
    assert not draws.gyro_bias.any()
    assert not draws.encoder_offset.any()
    assert_allclose(draws.imu_turn, np.tile(np.eye(3), (3, 1, 1)))
    assert (draws.push_speed, draws.noise) == (None, None)


def test_a_latency_beyond_the_buffer_is_refused(quadruped: Description, model: Model) -> None:
    tight = Herd(compile_model(quadruped), 2)
    late = replace(nominal(2, 4), latency=np.array([0.0, 0.03]))
    with pytest.raises(ValueError, match=r"a latency of 0\.03 s is beyond the 0\.008 s"):
        apply(tight, np.arange(2), late)
    apply(Herd(model, 2), np.arange(2), replace(late, latency=np.array([0.0, 0.06])))
    with pytest.raises(ValueError, match="has room for"):
        apply(Herd(model, 2), np.arange(2), replace(late, latency=np.array([0.0, 0.061])))


def test_a_push_changes_the_speed_along_the_floor_only(model: Model) -> None:
    herd = Herd(model, 100)
    herd.place(np.arange(100), np.repeat(settle(model)[None], 100, axis=0))
    before, ids = herd.qvel.copy(), np.arange(0, 100, 2)
    push(herd, ids, 0.3, np.random.default_rng(0))
    change = herd.qvel - before
    assert not change[1::2].any()
    assert not change[:, 2:].any()
    assert np.abs(change[ids, :2]).max() <= 0.3
    assert (change[ids, :2] != 0).all()
    push(herd, np.array([], dtype=np.intp), 0.3, np.random.default_rng(0))


def test_pushes_come_as_often_as_stated() -> None:
    draws, rng = replace(nominal(50, 4), push_every=0.5), np.random.default_rng(0)
    counts = sum(len(pushed(draws, 0.02, rng)) for _ in range(1000))
    assert_allclose(counts / 50, 1000 * 0.02 / 0.5, rtol=0.1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"latency": (-0.01, 0.02)}, "latency is .* 0 <= low <= high"),
        ({"latency": (0.03, 0.02)}, "latency is .* 0 <= low <= high"),
        ({"mass": (0.0, 1.1)}, "mass is .* 0 < low <= high"),
        ({"stiffness": (1.0, float("inf"))}, "stiffness is"),
        ({"friction": (float("nan"), 1.0)}, "friction is"),
        ({"gyro_bias": -0.1}, "gyro_bias is -0.1; it must be finite and not negative"),
        ({"encoder_offset": float("nan")}, "encoder_offset is nan"),
        ({"push_every": 0.0}, "push_every is 0.0; it must be above 0 s"),
    ],
)
def test_ranges_that_are_none_are_refused_by_name(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Randomisation(**changes)


def test_every_corner_is_the_robot_as_it_is_but_for_one_end_of_a_range() -> None:
    first, *others = corners(RANDOMISED)
    assert first == EXACT
    ends = set()
    for corner in others:
        changed = [field.name for field in fields(EXACT) if getattr(corner, field.name) != getattr(EXACT, field.name)]
        assert len(changed) == 1 or changed == ["stiffness", "damping"]
        for name in changed:
            low, high = getattr(corner, name)
            assert low == high
            ends.add((name, getattr(RANDOMISED, name).index(low)))
    both = {(name, end) for name in FACTORS if name != "skin" for end in (0, 1)}
    assert ends == both - {("voltage", 1)} | {("latency", 1)}


def test_draws_are_joined_row_by_row() -> None:
    one, two = drawn(count=3), drawn(seed=1, count=2)
    for name, value in arrays(joined([one, two])).items():
        assert_allclose(value, np.concatenate([arrays(one)[name], arrays(two)[name]]))
    with pytest.raises(ValueError, match="only some of the draws have latency"):
        joined([nominal(2, 4), one])


def test_pads_get_as_stiff_as_they_are_drawn_and_nothing_else_does(quadruped: Description) -> None:
    links = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    sprung = with_latency_room(make_spec(replace(quadruped, links=links), fidelity=Fidelity.SPRUNG))
    herd = Herd(sprung, 2)
    draws = draw(EXACT, np.random.default_rng(0), 2, sprung.nu, sprung.nbody - 1)
    apply(herd, np.arange(2), replace(draws, skin=np.array([0.25, 1.0])))
    slides = sprung.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    assert slides.sum() == 15
    for field, which in (("jnt_stiffness", slides), ("dof_damping", slides[sprung.dof_jntid])):
        own, given = getattr(sprung, field), herd.batch.expand(field)
        assert_allclose(given[0], own * np.where(which, 0.25, 1.0))
        assert_allclose(given[1], own)


def test_a_softer_skin_sags_by_as_much_more(quadruped: Description) -> None:
    links = tuple(replace(link, skin_thickness=0.02) for link in quadruped.links)
    sprung = with_latency_room(make_spec(replace(quadruped, links=links), fidelity=Fidelity.SPRUNG))
    herd = Herd(sprung, 3)
    draws = draw(EXACT, np.random.default_rng(0), 3, sprung.nu, sprung.nbody - 1)
    apply(herd, np.arange(3), replace(draws, skin=np.array([0.5, 1.0, 1e6])))
    herd.place(np.arange(3), np.repeat(settle(sprung)[None], 3, axis=0))
    for _ in range(200):
        herd.advance(np.repeat(sprung.key_ctrl[:1] if sprung.nkey else np.zeros((1, sprung.nu)), 3, axis=0))
    soft, usual, rigid = herd.qpos[:, 2]
    assert rigid > usual > soft
    assert (rigid - soft) / (rigid - usual) == pytest.approx(2.0, rel=0.1)
