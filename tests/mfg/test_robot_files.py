from __future__ import annotations

import io
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from mfg.description import Description, describe
from mfg.export import robot_visuals
from mfg.pipeline import Outcome, virtual
from mfg.robot_files import SKIN_MATERIAL, SKIN_THICKNESS, hull_triangles, mesh_files, mjcf, urdf
from sim.model import compile_model, drive_of, load_model


@pytest.fixture(scope="module")
def robot(built: Outcome) -> Description:
    return describe(built.blueprint)


@pytest.fixture(scope="module")
def folder(built: Outcome, robot: Description, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both robot files with their meshes."""
    folder: Path = tmp_path_factory.mktemp("robot")
    visuals = robot_visuals(built.blueprint, robot)
    for path, content in mesh_files(robot, visuals).items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(content)
    (folder / "robot.urdf").write_text(urdf(robot, visuals))
    (folder / "robot.xml").write_text(mjcf(robot, visuals))
    return folder


@pytest.fixture(scope="module", params=["robot.urdf", "robot.xml"])
def model(request: pytest.FixtureRequest, folder: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(folder / request.param))


def inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    return turn @ np.diag(model.body_inertia[body]) @ turn.T


def test_masses_and_inertias_are_those_of_the_description(model: mujoco.MjModel, robot: Description) -> None:
    for link in robot.links:
        body = model.body(link.name).id
        assert_allclose(model.body_mass[body], link.mass, rtol=1e-6)
        assert_allclose(model.body_ipos[body], link.com, atol=1e-7)
        assert_allclose(inertia(model, body), link.inertia, rtol=1e-6, atol=1e-6 * np.trace(link.inertia))


def test_joints_are_those_of_the_description(model: mujoco.MjModel, robot: Description) -> None:
    hinges = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
    assert [model.joint(j).name for j in hinges] == [joint.name for joint in robot.joints]
    for j, joint in zip(hinges, robot.joints, strict=True):
        assert_allclose(model.jnt_axis[j], joint.axis, atol=1e-9)
        assert_allclose(model.jnt_range[j], joint.range, atol=1e-9)
        assert model.joint(j).bodyid[0] == model.body(robot.links[joint.link].name).id


def test_bodies_stand_where_the_links_do(model: mujoco.MjModel, robot: Description) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    at = np.array([data.body(link.name).xpos for link in robot.links])
    assert_allclose(at - at[0], robot.origins() - robot.origins()[0], atol=1e-8)


def test_the_mjcf_stands_on_its_floor_and_stays_there(folder: Path, robot: Description) -> None:
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    data = mujoco.MjData(model)
    assert_allclose(data.qpos[2], robot.standing_height)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0 or data.contact.dist.min() > -1e-3
    for _ in range(250):
        mujoco.mj_step(model, data)
    assert np.isfinite(data.qpos).all()
    assert 0 < data.qpos[2] < robot.standing_height + 0.05
    assert np.abs(data.qpos[7:]).max() < 0.5  # the motors hold the pose


def test_the_mjcf_is_the_model_that_the_simulator_builds(folder: Path, robot: Description) -> None:
    """One robot, two ways in: the file and the builder."""
    file, direct = load_model(folder / "robot.xml"), compile_model(robot)
    assert_allclose(file.body_mass, direct.body_mass, rtol=1e-9)
    assert_allclose(file.dof_armature, direct.dof_armature, rtol=1e-9)
    assert_allclose(file.dof_frictionloss, direct.dof_frictionloss, rtol=1e-9)
    for name in ("actuator_gainprm", "actuator_biasprm", "actuator_dynprm", "actuator_forcerange", "actuator_delay"):
        assert_allclose(getattr(file, name), getattr(direct, name), rtol=1e-9, err_msg=name)
    a, b = drive_of(file), drive_of(direct)
    assert a.names == b.names
    assert_allclose(a.range, b.range, atol=1e-9)
    assert_allclose(a.continuous_torque, b.continuous_torque)
    touching = [m.geom_conaffinity.astype(bool) & (m.geom_type == mujoco.mjtGeom.mjGEOM_MESH) for m in (file, direct)]
    assert touching[0].sum() == touching[1].sum() == len(robot.links)


def test_the_imu_looks_the_way_the_controller_lies(model: mujoco.MjModel, robot: Description) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    host = data.body(robot.links[robot.imu_link].name)
    imu = data.site("imu") if model.nsite else data.body("imu")
    assert_allclose(imu.xpos - host.xpos, robot.T_link_imu[:3, 3], atol=1e-8)
    assert_allclose(imu.xmat.reshape(3, 3), robot.T_link_imu[:3, :3], atol=1e-8)


def test_hull_meshes_are_closed_and_convex(robot: Description) -> None:
    files = mesh_files(robot, [])
    assert len(files) == len(robot.links)
    for link in robot.links:
        mesh = trimesh.load(io.BytesIO(files[f"meshes/{link.name}_hull.stl"]), file_type="stl", force="mesh")
        assert mesh.is_watertight
        assert mesh.is_convex
        assert mesh.volume > 0
        assert mesh.volume == pytest.approx(trimesh.Trimesh(link.hull, hull_triangles(link.hull)).volume, rel=1e-5)


def test_a_virtual_robot_has_files_too(built: Outcome, tmp_path: Path) -> None:
    robot = describe(virtual(built.design).blueprint)
    for path, content in mesh_files(robot, []).items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(content)
    (tmp_path / "robot.xml").write_text(mjcf(robot))
    assert load_model(tmp_path / "robot.xml").nu == len(robot.joints)


def test_the_mjcf_tells_of_its_skin(folder: Path, robot: Description) -> None:
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    skin = robot.skin
    told = (skin.youngs_modulus, skin.wall, skin.infill, skin.density)
    assert_allclose(model.numeric(SKIN_MATERIAL).data, told)
    for link in robot.links:
        assert_allclose(model.numeric(SKIN_THICKNESS + link.name).data, link.skin_thickness)
