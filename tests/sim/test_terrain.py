"""The ground has the heights it states, robots stand on it, and the same terrain is the same bytes."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from experiments.simulate import TERRAINS
from mfg.description import Description
from mfg.robot_files import mesh_files, mjcf
from sim.actor import Gait
from sim.model import FLOOR, Model, compile_model, load_spec, make_spec
from sim.rollout import measure, roll_out, settle
from sim.surfaces import body_length
from sim.terrain import BLEND, CELL, EXTENT, FLIGHT, START, Kind, Terrain, ground_at, height_at, is_level, lay, samples
from sim.video import strip

FIELDS = (Kind.ROUGH, Kind.POTHOLES)
EVERY = pytest.mark.parametrize("kind", list(Kind))


def laid(description: Description, terrain: Terrain) -> Model:
    spec = make_spec(description)
    lay(spec, terrain)
    return spec.compile()


@pytest.fixture(scope="module")
def models(quadruped: Description) -> dict[Kind, Model]:
    return {kind: laid(quadruped, Terrain(kind)) for kind in Kind}


def places(count: int, seed: int = 0, reach: float = EXTENT - 0.1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-reach, reach, (2, count))


@pytest.mark.parametrize("kind", FIELDS)
def test_a_height_field_keeps_within_its_height_and_uses_it(kind: Kind) -> None:
    heights = samples(Terrain(kind, height=0.05))
    assert heights.max() - heights.min() <= 0.05
    assert heights.max() - heights.min() > 0.04
    if kind is Kind.POTHOLES:
        assert heights.max() == 0.0
        assert 0.05 < (heights < -0.02).mean() < 0.3  # some of the ground is holes, most is not
    assert heights.shape == (round(2 * EXTENT / CELL) + 1,) * 2


@pytest.mark.parametrize("feature", [0.3, 1.0])
def test_features_are_as_large_as_stated(feature: float) -> None:
    """Holes are a feature wide at most; bumps forget each other within one feature."""
    holes = samples(Terrain(Kind.POTHOLES, feature=feature)) < 0
    longest = max(len(run) for row in holes for run in "".join("#" if h else " " for h in row).split())
    assert 0.6 * feature - 2 * CELL <= longest * CELL <= feature + CELL
    rough = samples(Terrain(Kind.ROUGH, feature=feature)).astype(np.float64)[:, round((EXTENT + 1) / CELL) :]
    shift = round(feature / CELL)
    assert abs(np.corrcoef(rough[:, :-shift].ravel(), rough[:, shift:].ravel())[0, 1]) < 0.1
    assert np.corrcoef(rough[:, :-1].ravel(), rough[:, 1:].ravel())[0, 1] > 0.5


@EVERY
def test_the_start_is_flat(kind: Kind) -> None:
    x, y = places(500, reach=START / np.sqrt(2) - CELL)
    expected = np.tan(Terrain().angle) * x if kind is Kind.SLOPE else 0.0
    assert_allclose(height_at(Terrain(kind), x, y), expected, atol=1e-12)
    if kind in FIELDS:
        ring = np.linspace(0, 2 * np.pi, 200)
        edge = height_at(Terrain(kind), *((START + 0.2 * BLEND) * np.array([np.cos(ring), np.sin(ring)])))
        assert np.abs(edge).max() < 0.2 * Terrain().height  # and the relief begins gently


def test_a_slope_has_its_angle_and_leaves_the_robot_square_on_it(quadruped: Description) -> None:
    terrain = Terrain(Kind.SLOPE, angle=0.3)
    rise = height_at(terrain, 1.0, 0.3) - height_at(terrain, 0.0, -2.0)
    assert_allclose(np.arctan(rise), 0.3)
    model, flat = laid(quadruped, terrain), compile_model(quadruped)
    data, level = mujoco.MjData(model), mujoco.MjData(flat)
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(flat, level)
    turn = data.geom(FLOOR).xmat.reshape(3, 3)
    assert_allclose(turn @ [0, 0, 1], [-np.sin(0.3), 0, np.cos(0.3)], atol=1e-12)
    assert_allclose(data.xpos, level.xpos @ turn.T, atol=1e-12)


def test_stairs_go_up_a_flight_and_down_again_in_every_direction() -> None:
    terrain = Terrain(Kind.STEPS, height=0.04, feature=0.5)
    treads = START + 0.5 * (np.arange(13) + 0.5)
    up_and_down = 0.04 * np.array([1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1])
    assert FLIGHT == 3
    for x, y in ((treads, 0 * treads), (-treads, treads), (0 * treads, -treads)):
        assert_allclose(height_at(terrain, x, y), up_and_down)


@EVERY
def test_the_compiled_ground_is_the_stated_one(models: dict[Kind, Model], kind: Kind) -> None:
    x, y = places(3000)
    assert_allclose(ground_at(models[kind], x, y), height_at(Terrain(kind), x, y), atol=1e-8)
    assert is_level(models[kind]) is (kind is Kind.FLAT)
    assert models[kind].geom(FLOOR).bodyid[0] == 0


@EVERY
def test_a_ray_from_above_meets_the_ground_where_it_is_said_to_be(models: dict[Kind, Model], kind: Kind) -> None:
    model, data = models[kind], mujoco.MjData(models[kind])
    data.qpos[0] = 100.0  # out of the way
    mujoco.mj_forward(model, data)
    met = np.zeros(1, np.int32)
    for x, y in places(100).T:
        away = mujoco.mj_ray(model, data, np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0]), None, 1, -1, met)
        assert_allclose(5.0 - away, height_at(Terrain(kind), x, y), atol=1e-6)


@EVERY
def test_a_robot_stands_without_sinking_or_exploding(
    quadruped: Description, models: dict[Kind, Model], kind: Kind
) -> None:
    model = models[kind]
    start = settle(model)
    still = Gait(1.0, np.zeros(4), np.zeros(4), np.zeros(4))
    rolled = roll_out(model, [still], 2.0, start)
    behaviour = measure(model, rolled)[0]
    assert behaviour is not None
    assert not behaviour.fell
    assert behaviour.speed < 1e-3
    data = mujoco.MjData(model)
    data.qpos[:] = rolled.qpos[0, -1]
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    assert data.contact.dist.min() > -1e-3
    tall = np.cos(Terrain().angle) if kind is Kind.SLOPE else 1.0
    expected = height_at(Terrain(kind), *data.qpos[:2]) + quadruped.standing_height / tall
    assert_allclose(data.qpos[2], expected, atol=1e-3)


@EVERY
def test_a_robot_put_anywhere_stays_on_the_ground_under_a_gait(
    quadruped: Description, models: dict[Kind, Model], kind: Kind
) -> None:
    """Away from the start, where there is relief; the same bytes on 1, 2 and 3 threads."""
    model, (x, y) = models[kind], (3.3, -2.2)
    start = settle(model)
    start[1:4] = x, y, height_at(Terrain(kind), x, y) + quadruped.standing_height + 0.05
    gaits = [Gait(1.0 + 0.3 * k, np.full(4, 0.4), 1.5 * k * np.arange(4), np.zeros(4)) for k in range(3)]
    one, *others = (roll_out(model, gaits, 2.0, start, nthread=n) for n in (1, 2, 3))
    for other in others:
        assert one.qpos.tobytes() == other.qpos.tobytes()
        assert one.com.tobytes() == other.com.tobytes()
    assert not one.failed.any()
    above = one.com[..., 2] - height_at(Terrain(kind), one.com[..., 0], one.com[..., 1])
    assert above.min() > 0.02
    assert above.max() < body_length(model)


@pytest.mark.parametrize("kind", [*FIELDS, Kind.STEPS])
def test_what_is_dropped_rests_on_the_ground(quadruped: Description, kind: Kind) -> None:
    """A small box with three round feet touches the ground with all of them, at the heights that are stated."""
    terrain = Terrain(kind)
    spec = make_spec(quadruped)
    lay(spec, terrain)
    radius, feet = 0.01, 0.05 * np.array([[1, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]])
    height = height_at(terrain, 2.1, 1.3)
    stool = spec.worldbody.add_body(name="stool", pos=(2.1, 1.3, height + 0.05))
    stool.add_freejoint()
    for foot in feet:
        stool.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0), pos=foot, density=3000.0, contype=0,
                       friction=(1.0, 0.1, 0.1), solref=(0.02, 1.0))  # fmt: skip
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=500)
    assert np.abs(data.qvel[-6:]).max() < 1e-3
    found = data.body("stool").xpos + feet @ data.body("stool").xmat.reshape(3, 3).T
    steep = 1 + 0.5 * 0.3**2  # a ball touches beside its lowest point; slopes are below 0.3 here
    bottom = found[:, 2] - height_at(terrain, *found[:, :2].T)
    assert (bottom > radius - 1e-3).all()
    assert (bottom < radius * steep + 1e-4).all()


def test_a_robot_that_leaves_the_relief_is_caught_by_flat_ground(
    quadruped: Description, models: dict[Kind, Model]
) -> None:
    model = models[Kind.ROUGH]
    data = mujoco.MjData(model)
    data.qpos[:3] = EXTENT + 1.0, 0.0, quadruped.standing_height + 0.05
    mujoco.mj_step(model, data, nstep=250)
    assert_allclose(data.qpos[2], ground_at(model, EXTENT + 1, 0) + quadruped.standing_height, atol=2e-3)
    assert -0.04 < ground_at(model, EXTENT + 1, 0) < 0


@pytest.mark.parametrize("kind", FIELDS)
def test_the_same_terrain_is_the_same_bytes_and_another_seed_another_ground(
    quadruped: Description, models: dict[Kind, Model], kind: Kind
) -> None:
    samples.cache_clear()
    again = laid(quadruped, Terrain(kind))
    assert again.hfield_data.tobytes() == models[kind].hfield_data.tobytes()
    assert (samples(Terrain(kind, seed=1)) != samples(Terrain(kind))).mean() > 0.2


@EVERY
def test_the_ground_touches_as_the_floor_does(models: dict[Kind, Model], kind: Kind) -> None:
    floor, model = models[Kind.FLAT], models[kind]
    for geom in np.flatnonzero(model.geom_bodyid == 0):
        for field in ("geom_friction", "geom_solref", "geom_solimp", "geom_condim", "geom_contype", "geom_conaffinity"):
            assert_array_equal(getattr(model, field)[geom], getattr(floor, field)[floor.geom(FLOOR).id], err_msg=field)


def test_an_exported_robot_gets_the_same_ground(
    quadruped: Description, models: dict[Kind, Model], tmp_path: Path
) -> None:
    for name, content in mesh_files(quadruped, ()).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "robot.xml").write_text(mjcf(quadruped))
    for kind in (Kind.ROUGH, Kind.SLOPE, Kind.STEPS):
        spec = load_spec(tmp_path / "robot.xml")
        lay(spec, Terrain(kind))
        model = spec.compile()
        x, y = places(100)
        assert_allclose(ground_at(model, x, y), ground_at(models[kind], x, y), atol=1e-12)
        assert_allclose(model.qpos0, models[kind].qpos0, atol=1e-9)


def test_laying_a_terrain_keeps_the_budget_of_building_a_model(quadruped: Description) -> None:
    def seconds(kind: Kind) -> float:
        samples.cache_clear()
        before = time.process_time()
        laid(quadruped, Terrain(kind))
        return time.process_time() - before

    for kind in Kind:
        assert min(seconds(kind) for _ in range(4)) < 0.060, kind


@pytest.mark.parametrize("kind", [Kind.SLOPE, Kind.STEPS])
def test_uneven_ground_is_drawn(models: dict[Kind, Model], kind: Kind) -> None:
    still = Gait(1.0, np.zeros(4), np.zeros(4), np.zeros(4))
    pictures = [
        strip(models[k], roll_out(models[k], [still], 0.1, settle(models[k])), count=1, size=(96, 64))
        for k in (kind, Kind.FLAT)
    ]
    assert (pictures[0] != pictures[1]).any(axis=2).mean() > 0.05


def test_the_command_line_offers_every_kind() -> None:
    assert tuple(Kind) == TERRAINS


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("kind", "moon", r"kind is 'moon'; it must be one of flat, rough, potholes, slope, steps"),
        ("height", -0.01, r"height is -0.01 m; it must lie in \[0.0, 0.3\] m"),
        ("height", np.nan, r"height is nan m"),
        ("feature", 0.1, r"feature is 0.1 m; it must lie in \[0.2, 2.0\] m"),
        ("angle", 1.0, r"angle is 1.0 rad; it must lie in \[-0.7, 0.7\] rad"),
        ("seed", -1, r"seed is -1; it must be 0 or more"),
    ],
)
def test_malformed_values_are_refused(field: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(Terrain(), **{field: value})


@pytest.mark.parametrize("kind", [Kind.ROUGH, Kind.STEPS])
def test_a_terrain_is_laid_once(quadruped: Description, kind: Kind) -> None:
    spec = make_spec(quadruped)
    lay(spec, Terrain(kind))
    with pytest.raises(ValueError, match="robot quadruped has no bare plane named 'floor'"):
        lay(spec, Terrain(Kind.SLOPE))


@EVERY
def test_without_height_or_angle_every_terrain_is_flat(quadruped: Description, kind: Kind) -> None:
    terrain = Terrain(kind, height=0.0, angle=0.0)
    x, y = places(100)
    assert_allclose(height_at(terrain, x, y), 0.0)
    assert_allclose(ground_at(laid(quadruped, terrain), x, y), 0.0, atol=1e-12)
