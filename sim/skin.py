"""The soft skin in the simulator: a ladder from compliant contact to finite elements, one stiffness on every rung.

Pressed by the floor, the skin of a link is a spring of stiffness k (`sim.skin_law`). A contact gets it by its
parameters, a pad by its springs, a block of finite elements by its modulus.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from mfg.description import SkinMaterial
from mfg.robot_files import FRICTION, TIMESTEP, hull_triangles
from sim.skin_law import (
    DAMPING_TIME,
    FIRM_CONTACT_TIME,
    POISSON,
    Cover,
    cover_stiffness,
    fitted_solref,
    skin_mass,
)

MIXING = 1e6  # weight of a skin's contact parameters against those of a hard floor
FAR = 0.5  # share of a block that is its near part, which hardly touches the ground
_OFFERED_BY_NOBODY = 4  # a contact bit
_CORNERS = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


class Fidelity(StrEnum):
    """How the skin is modelled; the cost grows downwards."""

    COMPLIANT = "compliant"  # one convex hull per link with soft contact
    HULL = "hull"  # the same at 1 ms and with every corner of the hull that the robot's source has: a check
    SPRUNG = "sprung"  # each hull on three damped slides
    FLEX = "flex"  # the ends of limbs are one trilinear finite element each, held at the near side
    FLEX_FINE = "flex-fine"  # they are 2 x 2 x 2 elements, held at the near side and at the core

    @property
    def timestep(self) -> float:
        """Of the physics [s]."""
        return 0.001 if self is Fidelity.HULL else TIMESTEP

    @property
    def cells(self) -> int:
        """Finite elements along each side of a block, 0 where there is none."""
        return {Fidelity.FLEX: 1, Fidelity.FLEX_FINE: 2}.get(self, 0)


def apply(
    spec: mujoco.MjSpec, fidelity: Fidelity, covers: Sequence[Cover], material: SkinMaterial,
    contact_time: float | None = None,
) -> None:  # fmt: skip
    """Give every link of a specification the skin that its cover tells of.

    Args:
        spec: with one geom per cover, which is its hull and touches the floor.
        fidelity: how to model the skins.
        covers: of the links with a hull.
        material: of all skins.
        contact_time: time constant of soft contacts [s]; None fits each to its skin, as beside blocks always.

    Raises:
        ValueError: if a block of finite elements cannot be built.
    """
    blocks = []
    for cover in covers:
        if not cover.is_soft:
            continue
        if fidelity is Fidelity.SPRUNG:
            _sprung(spec, cover, material)
        elif fidelity.cells and cover.at_end:
            _block(spec, cover, material, fidelity.cells)
            blocks.append(cover)
        else:
            felt = spec.geom(cover.name)
            fitted = contact_time is None or fidelity.cells > 0
            felt.solref = fitted_solref(cover, material) if fitted else (contact_time, 1.0)
            felt.solmix = MIXING
    if fidelity is Fidelity.SPRUNG or fidelity.cells:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    if blocks:
        model = spec.compile()
        for cover in blocks:
            flex = spec.flex(skin_name(cover.name))
            flex.young *= block_compliance(model, flex.name) * cover_stiffness(cover, material)


def skin_name(link: str) -> str:
    """Name of what models a link's skin, where it is a thing of its own: a body and its geom, or a flex."""
    return f"{link}_skin"


def block_compliance(model: mujoco.MjModel, name: str) -> float:
    """Deflection per force of a block of finite elements [m/N]: the mean over the corners of its far half.

    A force along the surface normal at a point with node weights N moves that point by n . N K^-1 N^T n, where K is the
    stiffness of the nodes that are free.
    """
    flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, name)
    cells = model.flex_cellnum[flex]
    first, count = model.flex_nodeadr[flex], model.flex_nodenum[flex]
    bodies = model.flex_nodebodyid[first : first + count]
    free = np.flatnonzero([_is_node(model, body) for body in bodies])
    K = block_stiffness(model, name)[np.ix_(_coordinates(free), _coordinates(free))]
    at = model.flex_vertadr[flex] + np.arange(model.flex_vertnum[flex] - 1)  # the last one is the centre
    places = model.flex_vert0[at]
    points = 2 * places * model.flex_size[flex]  # along the block's own axes, as K is
    normals = _vertex_normals(points, hull_triangles(points))
    far = places[:, 2] > FAR
    weights = _node_weights(places[far], cells)[:, free]
    forces = np.einsum("vn,vi->vni", weights, normals[far]).reshape(far.sum(), -1)
    return float(np.einsum("vk,vk->v", forces, np.linalg.solve(K, forces.T).T).mean())


def _sprung(spec: mujoco.MjSpec, cover: Cover, material: SkinMaterial) -> None:
    """Move a link's hull and the share of its mass that is skin to a child body on three damped springs."""
    body, felt = spec.body(cover.name), spec.geom(cover.name)
    share = skin_mass(cover, material) / cover.mass
    stiffness = cover_stiffness(cover, material)
    pad = body.add_body(name=skin_name(cover.name))
    for axis in np.eye(3):
        pad.add_joint(
            type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, stiffness=[stiffness, 0, 0],
            damping=[DAMPING_TIME * stiffness, 0, 0],
        )  # fmt: skip
    _set_inertia(pad, share * cover.mass, cover.com, share * cover.inertia)
    _set_inertia(body, (1 - share) * cover.mass, cover.com, (1 - share) * cover.inertia)
    pad.add_geom(
        name=pad.name, type=felt.type, meshname=felt.meshname, pos=felt.pos, quat=felt.quat, mass=0.0, group=felt.group,
        contype=felt.contype, conaffinity=felt.conaffinity, condim=felt.condim, friction=felt.friction,
        solref=(FIRM_CONTACT_TIME, 1.0), solmix=MIXING,
    )  # fmt: skip
    spec.delete(felt)


def _block(spec: mujoco.MjSpec, cover: Cover, material: SkinMaterial, cells: int) -> None:
    """Replace the hull of a link by a block of finite elements around it, along the limb; its modulus is 1 MPa.

    Only nodes can be held by the bone, and those that are held must span a volume or at least a face: one held node is
    a ball joint, a row of them a hinge.
    """
    body = spec.body(cover.name)
    turn = _limb_axes(cover.hull.mean(0))
    local = cover.hull @ turn
    low, high = local.min(0), local.max(0)
    low, high = low - 1e-6 * (high - low), high + 1e-6 * (high - low)
    grid = np.stack(np.meshgrid(*[np.arange(cells + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (low + grid / cells * (high - low)) @ turn.T
    held = grid[:, 2] == 0
    if cells > 1:
        held |= (grid[:, :2] == cells // 2).all(1) & (grid[:, 2] < cells)
    shares = np.prod(np.where((grid == 0) | (grid == cells), 0.5, 1.0), axis=1) / cells**3
    masses = _removable(cover, points, np.where(held, 0.0, skin_mass(cover, material) * shares))
    names = [cover.name if h else f"{skin_name(cover.name)}_{k}" for k, h in enumerate(held)]
    for name, point, mass in zip(names, points, masses, strict=True):
        if name != cover.name:
            node = body.add_body(name=name, pos=point)
            _set_inertia(node, mass, np.zeros(3), 1e-6 * mass * np.eye(3))
            for axis in np.eye(3):
                node.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    triangles = hull_triangles(cover.hull)
    spec.add_flex(
        name=skin_name(cover.name), dim=3, radius=0.0, order=1, cellcount=[cells] * 3, nodebody=names,
        node=np.where(held[:, None], points, 0.0).ravel(), vertbody=[cover.name] * (len(cover.hull) + 1),
        vert=np.ravel([*cover.hull, cover.hull.mean(0)]),
        elem=np.insert(triangles, 3, len(cover.hull), axis=1).ravel().tolist(),
        young=1e6, poisson=POISSON, damping=DAMPING_TIME, selfcollide=mujoco.mjtFlexSelf.mjFLEXSELF_NONE,
        contype=0, conaffinity=1, condim=3, friction=FRICTION, solref=(FIRM_CONTACT_TIME, 1.0), solmix=MIXING,
    )  # fmt: skip
    # The hull is still there to be looked at and to measure the body by.
    felt = spec.geom(cover.name)
    felt.contype, felt.conaffinity = 0, _OFFERED_BY_NOBODY
    _set_inertia(body, *_without(cover, points, masses))


def _limb_axes(along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation whose columns are the axes of a block: z along a limb, x as near to a link's own axis as it can be."""
    length = float(np.linalg.norm(along))
    z = along / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    x = np.eye(3)[np.abs(z).argmin()]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _without(
    cover: Cover, points: NDArray[np.float64], masses: NDArray[np.float64]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Mass, centre and inertia of a link once point masses have been taken out of it."""
    mass = cover.mass - float(masses.sum())
    com = (cover.mass * cover.com - masses @ points) / mass
    arm, shift = points - cover.com, com - cover.com
    taken = float(masses @ (arm**2).sum(1)) * np.eye(3) - np.einsum("k,ki,kj->ij", masses, arm, arm)
    moved = mass * (shift @ shift * np.eye(3) - np.outer(shift, shift))
    return mass, com, cover.inertia - taken - moved


def _removable(cover: Cover, points: NDArray[np.float64], masses: NDArray[np.float64]) -> NDArray[np.float64]:
    """The point masses, made lighter until what they leave of the link has the inertia of a body."""
    for _ in range(20):
        least, middle, most = np.linalg.eigvalsh(_without(cover, points, masses)[2])
        if least > 0.05 * most and least + middle > 1.001 * most:
            break
        masses = masses / 2
    return masses


def _set_inertia(body: mujoco.MjsBody, mass: float, com: NDArray[np.float64], inertia: NDArray[np.float64]) -> None:
    I = inertia
    body.mass, body.ipos, body.iquat, body.explicitinertial = mass, com, (1.0, 0.0, 0.0, 0.0), True
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def block_stiffness(model: mujoco.MjModel, name: str) -> NDArray[np.float64]:
    """Stiffness of all nodes of a block along the block's axes [N/m], (3 n, 3 n), summed over its elements."""
    flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, name)
    cells = model.flex_cellnum[flex]
    nodes = np.arange(np.prod(cells + 1)).reshape(cells + 1)
    K = np.zeros((3 * nodes.size,) * 2)
    start = model.flex_stiffnessadr[flex]
    elements = model.flex_stiffness[start : start + 576 * np.prod(cells)].reshape(-1, 24, 24)
    for cell, element in zip(np.ndindex(*cells), elements, strict=True):
        where = _coordinates(nodes[tuple((_CORNERS + cell).T)])
        K[np.ix_(where, where)] -= element  # MuJoCo keeps the force, not the resistance
    return K


def _node_weights(places: NDArray[np.float64], cells: NDArray[np.int32]) -> NDArray[np.float64]:
    """Weight of every node at points of a block, each in [0, 1]^3, (k, n)."""
    scaled = places * cells
    hats = [np.maximum(0.0, 1.0 - np.abs(scaled[:, a, None] - np.arange(cells[a] + 1))) for a in range(3)]
    return np.einsum("vi,vj,vk->vijk", *hats).reshape(len(places), -1)


def _coordinates(nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    return (3 * np.asarray(nodes)[:, None] + np.arange(3)).ravel()


def _vertex_normals(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normals = np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, triangles[:, k], np.cross(b - a, c - a))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _is_node(model: mujoco.MjModel, body: int) -> bool:
    joint = model.body_jntadr[body]
    return bool(joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)
