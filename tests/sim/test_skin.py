"""The skin has the stiffness of its print on every rung of the ladder, and the robot stays the same robot."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfg.description import PAPER_SKIN, Description, SkinMaterial
from mfg.hulls import thinned
from mfg.parts import PAPER
from mfg.robot_files import CONTACT_TIME, mesh_files, mjcf
from sim.actor import Gait
from sim.model import ModelError, compile_model, drive_of, load_model, make_spec
from sim.rollout import roll_out, settle
from sim.skin import Fidelity, block_compliance, block_stiffness, skin_name
from sim.skin_law import (
    POISSON,
    Cover,
    contact_time,
    cover_stiffness,
    effective_modulus,
    pad_stiffness,
    skin_mass,
)
from sim.surfaces import body_length

THICKNESS = 0.025
BLOCKS = (Fidelity.FLEX, Fidelity.FLEX_FINE)
GRAVITY = 9.81


def ball(radii: tuple[float, float, float], centre: tuple[float, float, float]) -> np.ndarray:
    """Corners of an ellipsoid, as many as a hull has."""
    points = np.random.default_rng(0).standard_normal((2000, 3))
    return thinned(points / np.linalg.norm(points, axis=1, keepdims=True) * radii + centre, 128)


@pytest.fixture(scope="module")
def walker(quadruped: Description) -> Description:
    """The quadruped with stout round legs under 25 mm of skin."""
    foot = ball((0.05, 0.05, 0.09), (0.0, 0.0, -0.07))
    legs = [replace(link, hull=foot, skin_thickness=THICKNESS) for link in quadruped.links[1:]]
    return replace(quadruped, links=(replace(quadruped.links[0], skin_thickness=THICKNESS), *legs))


def cover_of(description: Description, index: int) -> Cover:
    link = description.links[index]
    weight = compile_model(description).body(link.name).invweight0[0]
    return Cover(link.name, link.skin_thickness, link.hull, link.mass, link.com, link.inertia, index > 0, weight)


def stood(model: mujoco.MjModel, seconds: float = 2.0) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    mujoco.mj_forward(model, data)
    return data


def test_without_a_wall_the_skin_is_gibson_and_ashbys_foam() -> None:
    bare = SkinMaterial(2.6e7, 0.0, 0.05, 1210.0)
    assert_allclose(effective_modulus(bare, 0.02, 0.07), 2.6e7 * 0.05**2)
    assert_allclose(pad_stiffness(bare, 0.02, 0.07, 2e-3), 2.6e7 * 0.05**2 * 2e-3 / 0.02)


def test_the_wall_adds_as_a_plate_where_the_surface_is_flat() -> None:
    h, t = 0.02, PAPER_SKIN.wall
    foundation, bending = 2.6e7 * 0.05**2 / h, 2.6e7 * t**3 / (12 * (1 - 0.45**2))
    tip = pad_stiffness(PAPER_SKIN, h, 1e9, 1e-12)  # hardly any patch: all is the plate's
    assert_allclose(tip, 8 * math.sqrt(foundation * bending), rtol=1e-4)


def test_a_curved_wall_and_a_thin_skin_are_stiffer() -> None:
    assert effective_modulus(PAPER_SKIN, 0.02, 0.04) > 1.2 * effective_modulus(PAPER_SKIN, 0.02, 0.08)
    assert pad_stiffness(PAPER_SKIN, 0.01, 0.06) > pad_stiffness(PAPER_SKIN, 0.02, 0.06)
    assert 1e5 < effective_modulus(PAPER_SKIN, 0.025, 0.07) < 3e5


def test_the_papers_skin_is_its_filament() -> None:
    assert SkinMaterial(2.6e7, PAPER.printer.line_width, 0.05, 1210.0) == PAPER_SKIN


@pytest.mark.parametrize("ratio", [1.0, 4.0])
@pytest.mark.parametrize("mass", [0.3, 3.0])
def test_a_fitted_contact_is_a_spring_of_the_material_whatever_rests_on_it(mass: float, ratio: float) -> None:
    stiffness = 3000.0 * mass  # so that both sink equally far, more than a millimetre
    time = contact_time(stiffness, 1 / mass, contacts=1) / ratio
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><option timestep='0.001'/><worldbody><geom type='plane' size='1 1 1'/><body pos='0 0 .1'>"
        f"<freejoint/><geom size='.1' mass='{mass}' solref='{time} {ratio}' solmix='1e6'/></body></worldbody></mujoco>"
    )
    data = stood(model, 4.0)
    assert_allclose(0.1 - data.qpos[2], mass * GRAVITY / stiffness, rtol=0.01)


def test_bare_bone_keeps_the_constant_contact_at_every_fidelity(quadruped: Description) -> None:
    for fidelity in Fidelity:
        model = compile_model(quadruped, fidelity=fidelity)
        touching = model.geom_conaffinity > 0
        assert_allclose(model.geom_solref[touching, 0], CONTACT_TIME)
        assert (model.nflex, model.nv) == (0, 10)


def test_the_fitted_contact_is_as_soft_as_each_links_own_skin_and_grips_as_ever(walker: Description) -> None:
    fitted = compile_model(walker, contact_time=None)
    assert_allclose(compile_model(walker).geom("leg_1").solref, [CONTACT_TIME, 1.0])
    for index, link in enumerate(walker.links):
        cover = cover_of(walker, index)
        expected = contact_time(cover_stiffness(cover, walker.skin), cover.inverse_mass)
        assert_allclose(fitted.geom(link.name).solref, [CONTACT_TIME, expected / CONTACT_TIME])
    assert_allclose(compile_model(walker, contact_time=0.03).geom("leg_1").solref[0], 0.03)


def sag(description: Description, **options: object) -> float:
    """How far the middle of a standing robot sinks below its place on hard ground."""
    hard = stood(compile_model(description, contact_time=0.01)).subtree_com[1, 2]
    soft = stood(compile_model(description, **options), 6.0)  # type: ignore[arg-type]
    return float(hard - soft.subtree_com[1, 2])


def test_a_sprung_robot_sags_by_its_weight_on_its_pads(walker: Description) -> None:
    pad = cover_stiffness(cover_of(walker, 1), walker.skin)
    soft = skin_mass(cover_of(walker, 1), walker.skin)
    expected = (walker.mass - 4 * soft) * GRAVITY / (4 * pad)
    model = compile_model(walker, fidelity=Fidelity.SPRUNG)
    data = stood(model)
    feet = [data.qpos[model.jnt_qposadr[model.body_jntadr[model.body(skin_name(f"leg_{k}")).id]] + 2]
            for k in range(1, 5)]  # fmt: skip
    assert_allclose(np.mean(feet), expected, rtol=0.03)


def test_the_fitted_contact_sags_as_the_finite_elements_do(walker: Description) -> None:
    """Within a third: what is left is how many corners share the load, 2.5 by assumption, and where it acts."""
    links = [replace(link, mass=2 * link.mass, inertia=2 * link.inertia) for link in walker.links]
    heavy = replace(walker, links=tuple(links))
    elements = sag(heavy, fidelity=Fidelity.FLEX)
    assert 2e-3 < elements < 6e-3
    assert_allclose(sag(heavy, contact_time=None), elements, rtol=0.33)
    assert sag(heavy, contact_time=CONTACT_TIME) < 0.15 * elements


@pytest.mark.parametrize("fidelity", list(Fidelity))
def test_the_robot_keeps_its_mass_and_its_centre(walker: Description, fidelity: Fidelity) -> None:
    model, plain = compile_model(walker, fidelity=fidelity), compile_model(walker)
    data, rest = mujoco.MjData(model), mujoco.MjData(plain)
    for m, d in ((model, data), (plain, rest)):
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
    assert_allclose(model.body_subtreemass[1], walker.mass, rtol=1e-9)
    for link in walker.links:
        a, b = (m.body(link.name).id for m in (model, plain))
        assert_allclose(model.body_subtreemass[a], plain.body_subtreemass[b], rtol=1e-9)
        assert_allclose(data.subtree_com[a], rest.subtree_com[b], atol=1e-7)


@pytest.mark.parametrize("fidelity", list(Fidelity))
def test_every_fidelity_stands_as_high_as_the_rigid_robot_and_does_not_fold(
    walker: Description, fidelity: Fidelity
) -> None:
    hard = stood(compile_model(walker, contact_time=0.01))
    data = stood(compile_model(walker, fidelity=fidelity))
    assert 0 < hard.qpos[2] - data.qpos[2] < 0.012
    assert_allclose(data.qpos[3:7], hard.qpos[3:7], atol=0.01)
    assert not [warning.number for warning in data.warning if warning.number]


def test_a_hanging_block_stretches_by_its_own_weight_as_the_formula_says(pendulum: Description) -> None:
    """One trilinear element held at its upper face, with half its mass lumped at the lower: u = (m/2) g / k.

    Its k is that of the element itself, which is stiffer than E A / l: the held face cannot narrow, and the lower one
    narrows at the price of shear. With axial strain e and lateral strain s z / l, the energy per volume is

        (lambda + 2 mu) (e^2 / 2 + s^2 / 3) + lambda (e s + s^2 / 3) + mu s^2 w^2 / (12 l^2).
    """
    size = (0.1, 0.1, 0.2)
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    rod = replace(pendulum.links[1], mass=2.0, com=np.array([0.0, 0.0, -0.1]), inertia=0.02 * np.eye(3),
                  hull=signs * size - (0.0, 0.0, 0.1), skin_thickness=0.04)  # fmt: skip
    spec = make_spec(replace(pendulum, links=(pendulum.links[0], rod)), fidelity=Fidelity.FLEX)
    spec.body("root").gravcomp = spec.body("rod").gravcomp = 1.0
    E = spec.flexes[0].young
    lam, mu = E * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), E / (2 * (1 + POISSON))
    width, length = size[0], size[2]
    along = lam + 2 * mu - lam**2 / (4 / 3 * (lam + mu) + mu * width**2 / (6 * length**2))
    mass = skin_mass(cover_of(replace(pendulum, links=(pendulum.links[0], rod)), 1), PAPER_SKIN)
    expected = mass / 2 * GRAVITY / (along * width**2 / length)
    assert_allclose(expected, mass * GRAVITY * length / (2 * E * width**2), rtol=0.01)  # near the exact bar's
    data = stood(spec.compile(), 3.0)
    moved = data.qpos[8:].reshape(4, 3)
    assert_allclose(-moved[:, 2], expected, rtol=0.01)


@pytest.mark.parametrize("fidelity", BLOCKS)
def test_a_pressed_block_yields_as_much_as_the_skin(walker: Description, fidelity: Fidelity) -> None:
    spec = make_spec(walker, fidelity=fidelity)
    model = spec.compile()
    stiffness = cover_stiffness(cover_of(walker, 1), walker.skin)
    assert_allclose(block_compliance(model, skin_name("leg_1")) * stiffness, 1.0, rtol=1e-9)
    assert 5e4 < spec.flex(skin_name("leg_1")).young < 2e6


def held_still(description: Description, fidelity: Fidelity) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A robot that floats, its torso too heavy to move and its joints too stiff to turn."""
    heavy = replace(description.links[0], mass=1e6, inertia=1e6 * np.eye(3))
    spec = make_spec(replace(description, links=(heavy, *description.links[1:])), fidelity=fidelity)
    for joint in description.joints:
        spec.joint(joint.name).stiffness = [1e6, 0, 0]
    model = spec.compile()
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.qpos[2] = 5.0
    return model, data


def test_the_compliance_of_a_block_is_what_the_simulator_makes_of_it(walker: Description) -> None:
    """Push the four free nodes of an element, each by its share, and see how far the point moves that they share."""
    model, data = held_still(walker, Fidelity.FLEX)
    free, shares, push = np.array([1, 3, 5, 7]), np.array([0.4, 0.1, 0.3, 0.2]), np.array([0.1, -0.2, 1.0])
    nodes = [model.body(f"{skin_name('leg_1')}_{k}").id for k in free]
    data.xfrc_applied[nodes, :3] = np.outer(shares, push)
    mujoco.mj_step(model, data, nstep=1500)
    places = [model.jnt_qposadr[model.body_jntadr[node]] for node in nodes]
    moved = sum(share * data.qpos[p : p + 3] for share, p in zip(shares, places, strict=True))
    coordinates = (3 * free[:, None] + np.arange(3)).ravel()
    K = block_stiffness(model, skin_name("leg_1"))[np.ix_(coordinates, coordinates)]
    corner, y, x = model.flex_node[[0, 2, 4]]  # held, so that their places are those in the link
    x, y = (axis / np.linalg.norm(axis) for axis in (x - corner, y - corner))
    force = np.outer(shares, np.stack([x, y, np.cross(x, y)]) @ push).ravel()
    assert_allclose(push @ moved, force @ np.linalg.solve(K, force), rtol=0.01)


def test_a_block_resists_neither_shift_nor_turn(walker: Description) -> None:
    model = compile_model(walker, fidelity=Fidelity.FLEX_FINE)
    values = np.linalg.eigvalsh(block_stiffness(model, skin_name("leg_1")))
    assert_allclose(values[:6], 0, atol=1e-9 * values[-1])
    assert values[6] > 1e-4 * values[-1]


def test_a_sprung_pad_is_as_stiff_as_the_skin(walker: Description) -> None:
    stiffness = cover_stiffness(cover_of(walker, 2), walker.skin)
    for axis in range(3):
        model, data = held_still(walker, Fidelity.SPRUNG)
        pad = model.body(skin_name("leg_2")).id
        data.xfrc_applied[pad, axis] = force = 10.0
        mujoco.mj_step(model, data, nstep=2000)
        assert_allclose(data.qpos[model.jnt_qposadr[model.body_jntadr[pad]] + axis], force / stiffness, rtol=2e-3)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("fidelity", list(Fidelity))
def test_a_passive_robot_never_gains_energy(walker: Description, fidelity: Fidelity, seed: int) -> None:
    """Touching ground, the skin stores energy that no record holds; free of it, all that was given back is there."""
    model = compile_model(walker, fidelity=fidelity)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    data.qpos[2] = 0.4
    data.qpos[3:7] = rng.standard_normal(4)
    data.qvel[:6] = rng.standard_normal(6)
    energy, free = [], []
    for _ in range(round(1.5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        energy.append(data.energy.sum())
        free.append(data.ncon == 0)
    flying = np.array(energy)[free]
    assert (np.diff(free) != 0).any()
    assert (flying <= np.minimum.accumulate(flying) + 0.01 * energy[0]).all()
    assert max(energy) <= energy[0] * (1 + 1e-6)
    assert energy[-1] < 0.3 * energy[0]
    assert not [warning.number for warning in data.warning if warning.number]


@pytest.mark.parametrize("fidelity", list(Fidelity))
def test_gaits_are_driven_and_measured_alike(walker: Description, fidelity: Fidelity) -> None:
    model = compile_model(walker, fidelity=fidelity)
    assert drive_of(model).names == tuple(joint.name for joint in walker.joints)
    assert_allclose(body_length(model), body_length(compile_model(walker)), rtol=1e-6)
    gait = Gait(1.5, np.full(4, 0.3), np.array([0.0, 3.0, 3.0, 0.0]), np.zeros(4))
    rollouts = roll_out(model, [gait], 0.5, settle(model))
    assert not rollouts.failed.any()
    assert rollouts.up[0, :, 2].min() > 0.8


def test_full_hulls_are_not_thinned_and_step_by_a_millisecond(walker: Description) -> None:
    points = np.random.default_rng(3).standard_normal((4000, 3))
    round_leg = 0.06 * points / np.linalg.norm(points, axis=1, keepdims=True) - (0.0, 0.0, 0.07)
    full = replace(walker, links=(walker.links[0], *(replace(link, hull=round_leg) for link in walker.links[1:])))
    counts = {}
    for fidelity in (Fidelity.COMPLIANT, Fidelity.HULL):
        model = compile_model(full, fidelity=fidelity)
        mesh = model.geom("leg_1").dataid[0]
        counts[fidelity] = model.mesh_graph[model.mesh_graphadr[mesh]]
        assert model.opt.timestep == fidelity.timestep
    assert counts[Fidelity.COMPLIANT] <= 128 < 1000 < counts[Fidelity.HULL]
    assert Fidelity.HULL.timestep == 0.001
    assert compile_model(full, fidelity=Fidelity.HULL, timestep=0.002).opt.timestep == 0.002


def pairs(model: mujoco.MjModel, data: mujoco.MjData) -> set[frozenset[str]]:
    names = [frozenset(model.body(model.geom_bodyid[g]).name for g in pair) for pair in data.contact.geom]
    return {pair for pair in names if "world" not in pair}


@pytest.fixture(scope="module")
def crossed(quadruped: Description) -> Description:
    """Two legs beside one another that cross when they swing, and two further ones whose hulls overlap at rest."""
    places = ((0.13, 0.05), (0.0, 0.05), (-0.13, 0.15), (-0.12, 0.14))
    legs = [replace(link, T=np.array([x, y, 0.0])) for link, (x, y) in zip(quadruped.links[1:], places, strict=True)]
    return replace(quadruped, links=(quadruped.links[0], *legs))


@pytest.mark.parametrize("fidelity", [Fidelity.COMPLIANT, Fidelity.SPRUNG])
@pytest.mark.parametrize("thickness", [0.0, THICKNESS])
def test_links_touch_one_another_when_they_may(crossed: Description, fidelity: Fidelity, thickness: float) -> None:
    soft = replace(crossed, links=tuple(replace(link, skin_thickness=thickness) for link in crossed.links))
    padded = fidelity is Fidelity.SPRUNG and thickness > 0
    leg_1, leg_2 = (skin_name(n) if padded else n for n in ("leg_1", "leg_2"))
    for self_collision in (True, False):
        model = compile_model(soft, fidelity=fidelity, self_collision=self_collision)
        data = mujoco.MjData(model)
        data.qpos[2] = 2.0
        mujoco.mj_forward(model, data)
        assert not pairs(model, data)  # never at rest
        data.qpos[drive_of(model).position] = [0.9, -0.8, 0.9, -0.9]
        mujoco.mj_forward(model, data)
        # The torso is every leg's parent; legs 3 and 4 overlap at rest.
        assert pairs(model, data) == ({frozenset((leg_1, leg_2))} if self_collision else set())
        data.qpos[2] = 0.1
        mujoco.mj_forward(model, data)
        assert data.ncon > len(pairs(model, data))  # the floor is still there


def test_finite_elements_do_not_touch_one_another(walker: Description) -> None:
    with pytest.raises(ValueError, match="do not touch one another"):
        compile_model(walker, fidelity=Fidelity.FLEX, self_collision=True)


def exported(description: Description, folder: Path) -> Path:
    for name, content in mesh_files(description, ()).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / "robot.xml").write_text(mjcf(description))
    return folder / "robot.xml"


@pytest.mark.parametrize("self_collision", [False, True])
@pytest.mark.parametrize("fidelity", list(Fidelity))
def test_the_exported_file_is_the_same_model(
    walker: Description, tmp_path: Path, fidelity: Fidelity, self_collision: bool
) -> None:
    if fidelity.cells and self_collision:
        return
    path = exported(walker, tmp_path)
    model = compile_model(walker, fidelity=fidelity, self_collision=self_collision, contact_time=None)
    again = load_model(path, fidelity=fidelity, self_collision=self_collision, contact_time=None)
    assert (again.nv, again.nflex, again.nexclude) == (model.nv, model.nflex, model.nexclude)
    scale = max(1.0, float(np.abs(model.flex_stiffness).max(initial=0.0)))
    assert_allclose(again.flex_stiffness, model.flex_stiffness, atol=1e-4 * scale)
    for field in ("body_mass", "body_pos", "geom_solref", "geom_contype", "geom_conaffinity", "jnt_stiffness",
                  "dof_damping", "flex_solref", "flex_damping"):  # fmt: skip
        assert_allclose(getattr(again, field), getattr(model, field), rtol=1e-4, atol=1e-7, err_msg=field)


def test_a_file_that_says_nothing_of_its_skin_has_the_papers_20_mm_thick(walker: Description, tmp_path: Path) -> None:
    path = exported(walker, tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line for line in lines if "<numeric" not in line))
    usual = replace(walker, links=tuple(replace(link, skin_thickness=0.02) for link in walker.links))
    ours, theirs = load_model(path, contact_time=None), compile_model(usual, contact_time=None)
    assert_allclose(ours.geom_solref, theirs.geom_solref, rtol=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="skin_thickness:leg_1" data="0.025"', 'name="skin_thickness:leg_1" data="-0.1"', "one thickness in"),
        ('name="skin_thickness:leg_1" data="0.025"', 'name="skin_thickness:leg_1" data="1 2"', "one thickness in"),
        ('name="skin_thickness:leg_1" data="0.025"', 'name="skin_thickness:leg_9" data="0.025"', "it must have both"),
        ('name="skin_material"', 'name="skin_stuff"', "'skin_material' is \\[\\]"),
        ('name="skin_material" data="26000000 ', 'name="skin_material" data="-1 ', "'skin_material' is \\[-1"),
        ('name="skin_material" data="26000000 ', 'name="skin_material" data="', "it must be modulus"),
    ],
)
def test_malformed_skin_data_is_refused_in_one_line(
    walker: Description, tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = exported(walker, tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ModelError, match=message) as refusal:
        load_model(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_light_link_gives_its_skin_no_more_than_it_has(walker: Description) -> None:
    feather = replace(walker.links[1], mass=0.02, inertia=1e-6 * np.eye(3))
    light = replace(walker, links=(walker.links[0], feather, *walker.links[2:]))
    for fidelity in Fidelity:
        model = compile_model(light, fidelity=fidelity)
        assert_allclose(model.body_subtreemass[1], light.mass, rtol=1e-9)
        assert (model.body_inertia[1:] > 0).all()
