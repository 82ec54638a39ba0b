"""What a robot's model file says about its skin: numerics that `mfg.robot_files` writes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mfg.description import PAPER_SKIN, SkinMaterial
from mfg.robot_files import SKIN_MATERIAL, SKIN_THICKNESS
from sim.skin_law import Cover

if TYPE_CHECKING:
    import mujoco

OLD_THICKNESS = 0.02  # of every link's skin, for a file that does not say [m]


def read_covers(spec: mujoco.MjSpec) -> tuple[SkinMaterial, list[Cover], dict[str, str]]:
    """The skins in a model file: their material, the cover of every link with a hull, and the parent of such a link.

    A link's hull is the mesh geom that has its name. Files from before there were numerics get the paper's material,
    20 mm thick on every link.

    Raises:
        ValueError: if the file does not compile, or its numerics are not those of its links' skins.
    """
    material, thicknesses = _numerics(spec)
    model = spec.compile()
    names = [model.body(body).name for body in range(model.nbody)]
    hulls = {names[model.geom_bodyid[geom]]: geom for geom in range(model.ngeom)
             if model.geom_dataid[geom] >= 0 and model.geom(geom).name == names[model.geom_bodyid[geom]]}  # fmt: skip
    if thicknesses is not None and set(thicknesses) != set(hulls):
        odd = min(set(thicknesses) ^ set(hulls))
        raise ValueError(f"link {odd!r} has either a hull or a numeric {SKIN_THICKNESS + odd!r}; it must have both")
    inner = {int(parent) for parent in model.body_parentid[1:]}
    covers, parents = [], {}
    for body, name in enumerate(names):
        if name not in hulls:
            continue
        thickness = OLD_THICKNESS if thicknesses is None else thicknesses[name]
        turn = _matrix(model.body_iquat[body])
        covers.append(Cover(
            name, thickness, _corners(model, hulls[name]), float(model.body_mass[body]), model.body_ipos[body].copy(),
            turn @ np.diag(model.body_inertia[body]) @ turn.T, body not in inner,
            float(model.body_invweight0[body, 0]),
        ))  # fmt: skip
        if names[model.body_parentid[body]] in hulls:
            parents[name] = names[model.body_parentid[body]]
    return material, covers, parents


def _numerics(spec: mujoco.MjSpec) -> tuple[SkinMaterial, dict[str, float] | None]:
    """Material and thickness by link [m]; no thickness where the file is older than that.

    Raises:
        ValueError: if they are not the numbers of a skin.
    """
    numbers = {numeric.name: [float(v) for v in numeric.data] for numeric in spec.numerics}
    told = {name.removeprefix(SKIN_THICKNESS): v for name, v in numbers.items() if name.startswith(SKIN_THICKNESS)}
    if SKIN_MATERIAL not in numbers and not told:
        return PAPER_SKIN, None
    values = numbers.get(SKIN_MATERIAL, [])
    if len(values) != 4 or not all(0 < v < math.inf for v in values) or values[1] >= 1 or values[2] > 1:
        raise ValueError(f"numeric {SKIN_MATERIAL!r} is {values}; it must be modulus [Pa], wall below 1 m, infill up "
                         "to 1 and density [kg/m3], all above 0")  # fmt: skip
    for link, thickness in told.items():
        if len(thickness) != 1 or not 0 <= thickness[0] < 1:
            raise ValueError(f"numeric {SKIN_THICKNESS + link!r} is {thickness}; it must be one thickness in [0, 1) m")
    return SkinMaterial(*values), {link: thickness[0] for link, thickness in told.items()}


def _corners(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """Corners of a geom's hull in the frame of its body [m], (n, 3)."""
    mesh = model.geom_dataid[geom]
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[first : first + count].astype(np.float64)
    points = points @ _matrix(model.geom_quat[geom]).T + model.geom_pos[geom]
    return points[np.sort(ConvexHull(points).vertices)]


def _matrix(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix of a unit quaternion, w first."""
    w, x, y, z = quaternion
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
