"""The meshes of a model, where they are in a pose, and how long a robot is by them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.model import Model


@dataclass(frozen=True, eq=False, slots=True)
class Surface:
    """A mesh of the robot in the frame of its geom.

    Attributes:
        geom: index of the geom that carries it.
        body: index of the body that carries that.
        vertices: (n, 3) [m].
        triangles: (m, 3).
        colour: red, green, blue, alpha in [0, 1].
        touches: whether it can touch the floor.
    """

    geom: int
    body: int
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colour: tuple[float, float, float, float]
    touches: bool


def surfaces(model: Model) -> list[Surface]:
    """Every mesh of a robot."""
    found = []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh, material = model.geom_dataid[geom], model.geom_matid[geom]
        first, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        r, g, b, a = (float(v) for v in (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]))
        found.append(Surface(
            int(geom), int(model.geom_bodyid[geom]),
            model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64),
            model.mesh_face[face : face + model.mesh_facenum[mesh]].astype(np.int64),
            (r, g, b, a), bool(model.geom_contype[geom] or model.geom_conaffinity[geom]),
        ))  # fmt: skip
    return found


def poses(model: Model, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose of every geom in the world, (k, ngeom, 4, 4), for each row of generalised positions (k, nq)."""
    data = mujoco.MjData(model)
    found = np.zeros((len(qpos), model.ngeom, 4, 4))
    found[..., 3, 3] = 1.0
    for row, positions in zip(found, qpos, strict=True):
        data.qpos[:] = positions
        mujoco.mj_kinematics(model, data)
        row[:, :3, :3] = data.geom_xmat.reshape(-1, 3, 3)
        row[:, :3, 3] = data.geom_xpos
    return found


def body_length(model: Model) -> float:
    """Greatest distance between any two points of the robot's hulls at rest [m]."""
    pose = poses(model, model.qpos0[None])[0]
    points = np.concatenate([
        surface.vertices @ pose[surface.geom, :3, :3].T + pose[surface.geom, :3, 3]
        for surface in surfaces(model) if surface.touches
    ])  # fmt: skip
    gap = points[:, None, :] - points[None, :, :]
    return float(np.sqrt((gap**2).sum(-1).max()))
