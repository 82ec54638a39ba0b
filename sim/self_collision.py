"""Which links of a robot may touch one another."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import mujoco

FLOOR_BIT, LINK_BIT = 1, 2  # the floor offers the first to links, a link that may touch its like the second
NEAR = 0.002  # hulls nearer than this at rest never touch: as near as the skins themselves are made [m]


def let_links_touch(spec: mujoco.MjSpec, hulls: Sequence[str], parents: Mapping[str, str]) -> None:
    """Let the hulls of a specification touch one another, apart from those that would touch at rest or at a hinge.

    A joint clears the skins about it only for the two links that it moves, so parent and child never touch here. All
    other pairs may, unless their hulls overlap (or nearly do) in the pose at rest: a hull fills the hollows of its
    link, so there the hulls meet where the links do not.

    Args:
        spec: of the robot.
        hulls: names of the geoms that are hulls.
        parents: name of the parent's hull by the child's.
    """
    for name in hulls:
        geom = spec.geom(name)
        geom.contype, geom.conaffinity = LINK_BIT, FLOOR_BIT | LINK_BIT
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for one, two in itertools.combinations(hulls, 2):
        first, second = model.geom(one), model.geom(two)
        near = mujoco.mj_geomDistance(model, data, first.id, second.id, 2 * NEAR, None) < NEAR
        if near or parents.get(one) == two or parents.get(two) == one:
            spec.add_exclude(bodyname1=model.body(first.bodyid[0]).name, bodyname2=model.body(second.bodyid[0]).name)
