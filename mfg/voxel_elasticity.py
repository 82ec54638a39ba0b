"""Linear elasticity on a grid of cubes: eight-node elements that bend, each with its own stiffness.

The element has the three quadratic modes per axis that let a cube bend without shear locking (incompatible modes,
E. L. Wilson et al., 1973), condensed once: every element of a grid is the same cube but for its modulus. Frame of this
file: the grid's own, origin at its lowest corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Array = NDArray[np.float64]
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])  # of a cube, in the order of its nodes
DIRECT = 4000  # unknowns up to which a direct solution is the faster one
TOLERANCE = 1e-4  # of the residual against the load: forces balance to far below the error of the model
PATIENCE = 4000  # iterations


@dataclass(frozen=True, eq=False, slots=True)
class VoxelModel:
    """Cubes with nodes at their corners.

    Attributes:
        cells: grid index of every cube, (n, 3).
        modulus: Young's modulus of every cube [Pa], (n,).
        spacing: edge of a cube [m].
        poisson: Poisson's ratio of all of them.
        nodes: grid index of every node, (m, 3).
        corner: node of every corner of every cube, in the order of `CORNERS`, (n, 8).
    """

    cells: NDArray[np.int64]
    modulus: Array
    spacing: float
    poisson: float
    nodes: NDArray[np.int64]
    corner: NDArray[np.int64]

    @staticmethod
    def of(modulus: Array, spacing: float, poisson: float) -> VoxelModel:
        """The cubes of a grid of moduli (nx, ny, nz) [Pa]; nothing is where the modulus is 0."""
        cells = np.argwhere(modulus > 0)
        shape = np.asarray(modulus.shape) + 1
        flat = np.ravel_multi_index(tuple(np.moveaxis(cells[:, None] + CORNERS, -1, 0)), tuple(shape))
        used, corner = np.unique(flat, return_inverse=True)
        nodes = np.stack(np.unravel_index(used, tuple(shape)), axis=-1)
        return VoxelModel(cells, modulus[tuple(cells.T)], spacing, poisson, nodes, corner.reshape(-1, 8))

    def points(self) -> Array:
        """Positions of the nodes [m], (m, 3)."""
        return np.asarray(self.nodes * self.spacing, np.float64)

    def displacements(self, forces: Array, held: NDArray[np.bool_]) -> Array | None:
        """Displacement of every node under every load [m], (loads, m, 3); None where it does not settle.

        Args:
            forces: on every node under every load [N], (loads, m, 3).
            held: nodes that do not move, (m,); every connected piece must hold at least three that are not in a line.
        """
        fixed = np.repeat(held, 3)
        free = np.flatnonzero(~fixed)
        K = self._stiffness()[free][:, free]
        loads = forces.reshape(len(forces), -1)[:, free]
        moved = np.zeros((len(forces), 3 * len(self.nodes)))
        if len(free) <= DIRECT:
            moved[:, free] = splu(K.tocsc()).solve(loads.T).T
        else:
            found = _settled(K, loads.T)
            if found is None:
                return None
            moved[:, free] = found.T
        return moved.reshape(len(forces), -1, 3)

    def strains(self, moved: Array) -> Array:
        """Strain (xx, yy, zz, xy, yz, zx; shear as angles) at the eight Gauss points of every cube, (loads, n, 8, 6).

        Args:
            moved: displacement of every node under every load [m], (loads, m, 3).
        """
        _, recover = _element(self.poisson)
        local = moved[:, self.corner].reshape(len(moved), len(self.corner), 24)
        return np.asarray(np.einsum("gse,lne->lngs", recover, local, optimize=True) / self.spacing)

    def _stiffness(self) -> sparse.csr_matrix:
        unit, _ = _element(self.poisson)
        # Stiffness of a cube grows with its edge: strains as 1 / h twice, volume as h^3.
        values = (self.modulus * self.spacing)[:, None, None] * unit
        dof = (3 * self.corner[:, :, None] + np.arange(3)).reshape(-1, 24)
        rows = np.repeat(dof, 24, axis=1).ravel()
        columns = np.tile(dof, (1, 24)).ravel()
        size = 3 * len(self.nodes)
        return sparse.csr_matrix(sparse.coo_matrix((values.ravel(), (rows, columns)), shape=(size, size)))


def _settled(K: sparse.csr_matrix, loads: Array) -> Array | None:
    """Solve K x = load for every column (n, loads), by conjugate gradients side by side: K passes memory once."""
    inverse = (1.0 / K.diagonal())[:, None]
    x, r = np.zeros_like(loads), loads.copy()
    aim = TOLERANCE**2 * np.square(loads).sum(axis=0)
    p = inverse * r
    along = (r * p).sum(axis=0)
    for _ in range(PATIENCE):
        if (np.square(r).sum(axis=0) <= aim).all():
            return x
        Kp = K @ p
        # A load that is balanced, or none at all, stands still.
        step = along / np.maximum((p * Kp).sum(axis=0), np.finfo(np.float64).tiny)
        x += step * p
        r -= step * Kp
        z = inverse * r
        before, along = along, (r * z).sum(axis=0)
        p = z + along / np.maximum(before, np.finfo(np.float64).tiny) * p
    return None


def von_mises(strain: Array, modulus: float, poisson: float) -> Array:
    """Von Mises stress [Pa] of an isotropic material under strains (..., 6) as `VoxelModel.strains` gives them."""
    stress = strain @ elasticity(poisson) * modulus
    x, y, z, xy, yz, zx = np.moveaxis(stress, -1, 0)
    square = ((x - y) ** 2 + (y - z) ** 2 + (z - x) ** 2) / 2 + 3 * (xy**2 + yz**2 + zx**2)
    return np.asarray(np.sqrt(square), np.float64)


@lru_cache(maxsize=8)
def elasticity(poisson: float) -> Array:
    """Stress per strain of an isotropic material with Young's modulus 1, (6, 6)."""
    lame = poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = 0.5 / (1 + poisson)
    D = np.diag([2 * shear] * 3 + [shear] * 3)
    D[:3, :3] += lame
    return D


@lru_cache(maxsize=8)
def _element(poisson: float) -> tuple[Array, Array]:
    """Stiffness (24, 24) of the unit cube of modulus 1, and strain at its Gauss points from its corners (8, 6, 24)."""
    D = elasticity(poisson)
    at = (2 * CORNERS - 1) / np.sqrt(3.0)  # in [-1, 1]^3
    sign = 2.0 * CORNERS - 1.0
    B = np.zeros((8, 6, 24))
    G = np.zeros((8, 6, 9))
    for g, point in enumerate(at):
        factor = (1 + sign * point) / 2  # (corner, axis)
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            slope = sign[:, a] * factor[:, b] * factor[:, c]  # d N / d x on a cube of edge 1
            _place(B[g], slope, a, 3 * np.arange(8))
            # The modes 1 - xi^2 of each axis move in all three directions; their slope is -2 xi times 2 per edge.
            _place(G[g], np.array([-4.0 * point[a]]), a, np.array([3 * a]))
    weight = 1 / 8
    uu, au, aa = (
        sum((P.T @ D @ Q * weight for P, Q in zip(left, right, strict=True)), np.zeros((left.shape[2], right.shape[2])))
        for left, right in ((B, B), (G, B), (G, G))
    )
    modes = -np.linalg.solve(aa, au)
    return uu + au.T @ modes, B + G @ modes


def _place(strain: Array, slope: Array, axis: int, first: NDArray[np.int64]) -> None:
    """Write what shapes with this slope along one axis do to the strain, for motion along x, y and z."""
    shear = {0: (None, 3, 5), 1: (3, None, 4), 2: (5, 4, None)}[axis]
    for direction in range(3):
        row = axis if direction == axis else shear[direction]
        strain[row, first + direction] += slope
