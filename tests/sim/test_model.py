"""The compiled model is the described robot, and it obeys mechanics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfg.description import Description
from mfg.parts import J60_6
from mfg.robot_files import mesh_files, mjcf
from sim.model import (
    CONTACT_TIME,
    ModelError,
    compile_model,
    drive_of,
    load_model,
    model_name,
    quantised,
)
from sim.surfaces import body_length


def test_every_link_keeps_its_mass_centre_and_inertia(quadruped: Description) -> None:
    model = compile_model(quadruped)
    assert model.nbody == 1 + len(quadruped.links)
    for body, link in enumerate(quadruped.links, start=1):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[body])
        principal = turn.reshape(3, 3)
        assert_allclose(model.body_mass[body], link.mass)
        assert_allclose(model.body_ipos[body], link.com, atol=1e-12)
        assert_allclose(principal @ np.diag(model.body_inertia[body]) @ principal.T, link.inertia, atol=1e-12)
    assert_allclose(model.body_subtreemass[1], quadruped.mass)


def test_every_joint_keeps_its_place_axis_range_and_motor(quadruped: Description) -> None:
    model = compile_model(quadruped)
    drive = drive_of(model)
    assert drive.names == tuple(joint.name for joint in quadruped.joints)
    for index, joint in enumerate(quadruped.joints):
        compiled = model.joint(joint.name)
        body = joint.link + 1
        assert compiled.bodyid[0] == body
        assert_allclose(model.body_pos[body], quadruped.links[joint.link].T)
        assert_allclose(compiled.axis, joint.axis)
        assert_allclose(drive.range[index], joint.range)
        assert model.jnt_limited[compiled.id]
        assert_allclose(model.dof_armature[drive.velocity[index]], joint.motor.armature)
        assert_allclose(model.dof_frictionloss[drive.velocity[index]], joint.motor.friction)
        assert_allclose(drive.continuous_torque[index], joint.motor.continuous_torque)
        assert_allclose(model.actuator_forcerange[index], [-joint.motor.peak_torque, joint.motor.peak_torque])
        assert_allclose(model.actuator_delay[index], joint.motor.latency)


def test_links_touch_the_floor_and_nothing_else(quadruped: Description) -> None:
    model = compile_model(quadruped)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.05
    data.qpos[drive_of(model).position] = [0.9, -0.7, 0.9, -0.7]
    mujoco.mj_forward(model, data)
    floor = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    touching = data.contact.geom
    assert len(touching)
    assert (np.isin(touching, floor).sum(axis=1) == 1).all()
    assert_allclose(data.contact.solref[:, 0], CONTACT_TIME)


def test_standing_height_puts_the_lowest_point_on_the_floor(quadruped: Description) -> None:
    model = compile_model(quadruped)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=400)
    assert_allclose(data.qpos[2], quadruped.standing_height, atol=1e-3)


def test_body_length_is_the_greatest_extent(quadruped: Description) -> None:
    points = np.concatenate([o + link.hull for o, link in zip(quadruped.origins(), quadruped.links, strict=True)])
    longest = max(float(np.linalg.norm(a - b)) for a in points for b in points)
    assert_allclose(body_length(compile_model(quadruped)), longest, rtol=1e-6)


def test_gains_are_rounded_down_to_the_wires_steps() -> None:
    assert quantised(0.5, 0.2) == pytest.approx(0.4)
    assert quantised(1.6, 0.2) == pytest.approx(1.6)
    assert quantised(40.0, 1.0) == 40.0


def test_a_command_acts_after_the_latency(pendulum: Description) -> None:
    model = compile_model(pendulum)
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5
    felt = []
    for _ in range(5):
        mujoco.mj_step(model, data)
        felt.append(abs(float(data.actuator_force[0])) > 1.0)
    assert felt.index(True) == round(J60_6.latency / model.opt.timestep)


def exported(description: Description, folder: Path) -> Path:
    for name, content in mesh_files(description, ()).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / "robot.xml").write_text(mjcf(description))
    return folder / "robot.xml"


@pytest.mark.parametrize("timestep", [0.004, 0.001])
def test_the_exported_file_is_the_compiled_model(quadruped: Description, tmp_path: Path, timestep: float) -> None:
    model = compile_model(quadruped, timestep=timestep)
    again = load_model(exported(quadruped, tmp_path), timestep=timestep)
    for field in ("body_mass", "body_pos", "body_inertia", "body_ipos", "jnt_axis", "jnt_range", "dof_armature",
                  "dof_frictionloss", "actuator_gainprm", "actuator_forcerange", "actuator_delay", "actuator_history",
                  "actuator_user", "geom_friction", "geom_solref", "geom_condim", "geom_contype", "geom_conaffinity",
                  "site_pos", "site_quat", "qpos0"):  # fmt: skip
        assert_allclose(getattr(again, field), getattr(model, field), rtol=1e-6, atol=1e-9, err_msg=field)
    for option in ("timestep", "integrator", "cone", "impratio", "gravity"):
        assert_allclose(getattr(again.opt, option), getattr(model.opt, option), err_msg=option)
    assert model_name(again) == model_name(model) == "quadruped"
    assert_allclose(body_length(again), body_length(model), rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not xml", "not a readable MJCF"),
        ("<mujoco/>", "0 free joints"),
        ("<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>", "no actuator"),
        ("<mujoco><worldbody><body><freejoint/><geom size='1'/><body><joint name='j'/><geom size='1'/></body></body>"
         "</worldbody><actuator><motor name='m' joint='j'/></actuator></mujoco>", "'m' is not a dcmotor"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_robot_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(ModelError, match=message):
        load_model(path)


def test_a_missing_file_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_model(tmp_path / "robot.xml")


def test_a_robot_without_joints_or_mass_is_refused(quadruped: Description) -> None:
    with pytest.raises(ValueError, match="no joint to drive"):
        compile_model(replace(quadruped, joints=()))
    weightless = replace(quadruped.links[1], mass=0.0, inertia=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="quadruped is no model"):
        compile_model(replace(quadruped, links=(quadruped.links[0], weightless, *quadruped.links[2:])))
