"""The stress of one half of a motor mount in its bone, by sections: fast enough to judge every seat that is tried.

The bone around the mount is cut by ever larger cans. Each cut is a rigid section on an elastic bed (in a straight limb:
the beam formulas M c / I, T r / J and their sum), and the worst cut counts, raised by what sections cannot see. It errs
to the careful side of `mfg.mount_elasticity`, to which it is fitted: see `NOTCH`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mfg.fields import Field, about_axis, coverage, cylindrical
from mfg.linked_cells import AZIMUTHS, linked
from mfg.mounts import Mount, motor_pose
from mfg.strength import (
    BODY_SHARE,
    DIRECTIONS,
    PIECE,
    POISSON,
    Half,
    Plastic,
    keepout,
    load_cases,
    safety_factor,
    span,
    superposed,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

CELL = 5.0e-3  # edge of a cell of the sampled bone, along and across [m]
LAYERS = 8  # cans beyond the mount's own rim, `CELL` apart: what lies so far away counts as the body
COARSE = 2  # samples of the bone to one of the lattice on which pieces are told apart
CUTS = (0, 1, 2, 4, 7)  # layers at which a section is taken
SEEN = 0.25  # least filled share of a cell whose stress counts
# What sections cannot see: stress at corners over that of sections, and the stress of the mount itself, whose walls
# bend as they hand the load over, in units of the peak torque over its radius squared and the walls' thickness.
# Fitted to finite elements of 5 mm on random mounts in random bodies: 70 with 3 walls (rank correlation 0.92, strength
# here over strength there 0.43, 0.65, 0.96 at quantiles 5, 50, 95 %), 64 with 6 walls (0.85; 0.35, 0.64, 1.03).
# Of 66 with a safety factor of 2 or more here, one had less there (1.8). Elements of 3 mm say a tenth less than 5 mm.
NOTCH: dict[Half, float] = {"holder": 2.0, "connector": 1.3}
OWN: dict[Half, float] = {"holder": 1.38, "connector": 1.68}


@dataclass(frozen=True, eq=False, slots=True)
class _Shell:
    """The cells of a can around a mount, in rows along its meridian.

    Attributes:
        z, r: layer and ring of every row, (n,).
        z_inner, r_inner: of the nearest row of the next smaller can, (n,).
        radius: ring of its side.
        filled: the cells that count, (n, AZIMUTHS).
    """

    z: Index
    r: Index
    z_inner: Index
    r_inner: Index
    radius: int
    filled: Mask


@dataclass(frozen=True, eq=False, slots=True)
class _Cells:
    """The filled cells of one can, as far as they do not depend on the plastic.

    Attributes:
        point: middle of every cell [m], (n, 3), frame of `Sections`.
        normal: of the can there, (n, 3).
        area: that a cell cuts [m2], (n,).
        depth: of the bone [m], (n,).
    """

    point: Array
    normal: Array
    area: Array
    depth: NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class _Lattice:
    """The whole bone, on a coarse lattice on which pieces are told apart.

    Attributes:
        bone: its depth there.
        solid: the samples that count as bone.
        radial, along: distance of every sample from the hinge axis and height along it [m].
        half: volume of so much of the bone that the rest counts as the body [m3].
    """

    bone: Field
    solid: Mask
    radial: NDArray[np.float32]
    along: NDArray[np.float32]
    half: float

    @staticmethod
    def of(bone: Field, T_design_hinge: Array) -> _Lattice:
        """Every `COARSE`th sample of a bone."""
        x, y, z = (c / COARSE for c in bone.corner)
        thin = np.ascontiguousarray(bone.values[::COARSE, ::COARSE, ::COARSE])
        coarse = Field(thin, (x, y, z), bone.spacing * COARSE)
        radial, along = cylindrical(coarse.axes(), T_design_hinge[:3, 3], T_design_hinge[:3, 2])
        # A thin limb must not fall through the lattice.
        return _Lattice(coarse, thin > -coarse.spacing / 4, radial, along, BODY_SHARE * coarse.volume())


@dataclass(frozen=True, eq=False, slots=True)
class Sections:
    """One bone sampled about a hinge axis, as far as any offset and any section of it reach.

    Frame: the motor's at offset 0, z along the hinge axis.

    Attributes:
        mount: the mount.
        plastic: what the bone is printed of.
        depth: of the bone at the middle of every cell [m], (height, radius, angle).
        low: lower edge of the first layer of cells [m].
        lattice: the whole bone.
        T_design_hinge: pose of the hinge's frame.
        known: shells that were found, which do not depend on the plastic.
        cells: those of the shells that were cut, by the shell's key and its place; nor do they.
    """

    mount: Mount
    plastic: Plastic
    depth: NDArray[np.float32]
    low: float
    lattice: _Lattice
    T_design_hinge: Array
    known: dict[tuple[float, Half, bool], list[_Shell] | None] = field(default_factory=dict)
    cells: dict[tuple[float, Half, bool, int], _Cells] = field(default_factory=dict)

    @staticmethod
    def sample(bone: Field, position: Array, axis: Array, mount: Mount, plastic: Plastic, reach: float) -> Sections:
        """Sample a bone about a hinge for offsets from -reach to +reach along its axis [m]."""
        tall = reach + max(-mount.base_low, mount.connector_high) + (LAYERS + 1) * CELL
        half = int(np.ceil(tall / CELL))
        rings = round((mount.connector_radius - mount.attach_radius) / CELL) + LAYERS
        height = (np.arange(2 * half) + 0.5 - half) * CELL
        radius = mount.attach_radius + (np.arange(rings) + 0.5) * CELL
        T = motor_pose(position, axis, 0.0)
        depth = bone.sample_at(*about_axis(T, radius[:, None], _angles(), height[:, None, None]))
        return Sections(mount, plastic, depth, -half * CELL, _Lattice.of(bone, T), T)

    def safety(self, offset: float, half: Half, flipped: bool = False, least: float = 0.0) -> float:
        """Strength over the greatest stress in any section around one half of the mount; 0 where nothing holds it.

        Args:
            offset: of the motor along the hinge axis [m].
            half: which half of the mount this bone carries.
            flipped: whether the motor's output points against the hinge axis.
            least: factor that matters; of a mount below it, only that it is below is found out.
        """
        most = self.plastic.strength / least if least > 0 else np.inf
        return safety_factor(self.stress(offset, half, flipped, most), self.plastic.strength)

    def stress(self, offset: float, half: Half, flipped: bool = False, most: float = np.inf) -> float:
        """The greatest stress in any section, notches included [Pa]; infinite where the bone has no hold.

        Sections beyond the first one with more than `most` are not looked at.
        """
        outer = span(self.mount, half)[0]
        own = OWN[half] * self.mount.motor.peak_torque / (outer**2 * self.plastic.wall)
        worst = 0.0
        key = offset, half, flipped
        if key not in self.known:
            self.known[key] = self._shells(offset, half, flipped)
        shells = self.known[key]
        if shells is None:
            return np.inf
        for k in CUTS:
            if k < len(shells) and NOTCH[half] * worst + own <= most:
                if (*key, k) not in self.cells:
                    self.cells[*key, k] = self._cells(shells[k])
                found = self._cut(self.cells[*key, k])
                if found is None:
                    return np.inf
                worst = max(worst, found)
        return NOTCH[half] * worst + own

    def _shells(self, offset: float, half: Half, flipped: bool) -> list[_Shell] | None:
        """The cans around one half of a mount, as far as half of the bone lies within, with the cells on the way there.

        On the way are cells that hang together with the mount inwards and with the body outwards: a lump that only sits
        on the mount or on the bone hands no load on. None where the mount hangs on no body.
        """
        outer, low, high = span(self.mount, half)
        first, last = self._layers(offset, low, high, flipped)
        a, b, m = first - 1, last, round((outer - self.mount.attach_radius) / CELL)
        room = self._room(offset, half, flipped)
        marks = np.zeros_like(room)
        shells: list[_Shell] = []
        held = 0.0
        while len(shells) < LAYERS and held <= self.lattice.half and a >= 0 and b < len(room) and m < room.shape[1]:
            # Along a meridian of the can: out on its lower face, up its side, back on its upper face.
            z = np.concatenate([np.full(m, a), np.arange(a, b + 1), np.full(m, b)])
            r = np.concatenate([np.arange(m), np.full(b - a + 1, m), np.arange(m)[::-1]])
            shell = _Shell(z, r, z.clip(a + 1, b - 1), np.minimum(r, m - 1), m, room[z, r])
            if shells:
                shell = replace(shell, filled=linked(shell.filled, marks[shell.z_inner, shell.r_inner]))
            if not shell.filled.any():
                return None
            marks[z, r] = shell.filled
            shells.append(shell)
            arc = (self.mount.attach_radius + (r + 0.5) * CELL) * (2 * np.pi / AZIMUTHS)
            held += CELL**2 * float((shell.filled * coverage(self.depth[z, r], CELL)).sum(axis=1) @ arc)
            a, b, m = a - 1, b + 1, m + 1
        if not shells:
            return None
        outermost = shells[-1]
        shells[-1] = replace(outermost, filled=outermost.filled & self._body(outermost))
        marks[:] = False
        for k in range(len(shells) - 1, 0, -1):
            shell, inner = shells[k], shells[k - 1]
            np.logical_or.at(marks, (shell.z_inner, shell.r_inner), shell.filled)
            shells[k - 1] = replace(inner, filled=linked(inner.filled, marks[inner.z, inner.r]))
        return shells

    def _body(self, shell: _Shell) -> Mask:
        """The cells of a can next to a large piece of the bone beyond it."""
        T, lattice = self.T_design_hinge, self.lattice
        edge = self.low + (shell.z.min() + 0.5) * CELL, self.low + (shell.z.max() + 0.5) * CELL
        side = self.mount.attach_radius + (shell.radius + 0.5) * CELL
        outside = (lattice.radial > side) | (lattice.along < edge[0]) | (lattice.along > edge[1])
        pieces, _ = ndimage.label(lattice.solid & outside)
        sizes = np.bincount(pieces.ravel())
        sizes[0] = 0
        large = _beside((sizes >= PIECE * lattice.solid.sum())[pieces])
        radius = self.mount.attach_radius + (shell.r + 0.5) * CELL
        flat = radius[:, None, None] * (_circle() @ T[:3, :2].T)
        points = T[:3, 3] + flat + (self.low + (shell.z + 0.5) * CELL)[:, None, None] * T[:3, 2]
        index = np.rint((points - lattice.bone.origin) / lattice.bone.spacing).astype(int)
        index = index.clip(0, np.array(large.shape) - 1)
        return np.asarray(large[tuple(np.moveaxis(index, -1, 0))], bool)

    def _layers(self, offset: float, low: float, high: float, flipped: bool) -> tuple[int, int]:
        """The first layer of cells inside of two heights of the motor frame, and the first one beyond."""
        low, high = (offset - high, offset - low) if flipped else (offset + low, offset + high)
        return round((low - self.low) / CELL), round((high - self.low) / CELL)

    def _room(self, offset: float, half: Half, flipped: bool) -> Mask:
        """The cells that count and that the other half of the mount leaves to the bone."""
        outer, low, high = keepout(self.mount, half)
        first, last = self._layers(offset, low, high, flipped)
        room = self.depth > (SEEN - 0.5) * CELL
        room[max(first, 0) : max(last, 0), : int(np.ceil((outer - self.mount.attach_radius) / CELL - 1e-9))] = False
        return room

    def _cells(self, shell: _Shell) -> _Cells:
        """The filled cells of a can."""
        along, around = np.nonzero(shell.filled)
        z, r = shell.z[along], shell.r[along]
        radius = self.mount.attach_radius + (r + 0.5) * CELL
        circle = _circle()[around]
        side = (r == shell.radius).astype(np.float64)
        normal = np.column_stack([circle * side[:, None], 1.0 - side])
        point = np.column_stack([radius[:, None] * circle, self.low + (z + 0.5) * CELL])
        area = np.asarray(CELL * (2 * np.pi / AZIMUTHS) * radius, np.float64)
        return _Cells(point, normal, area, self.depth[z, r, around])

    def _cut(self, cells: _Cells) -> float | None:
        """The greatest stress in one section [Pa]; None where it cannot carry a couple."""
        if len(cells.area) < 4:
            return None
        weight = cells.area * self.plastic.stiffness(cells.depth, CELL)
        # The middle of the section as the origin: a couple has no place of its own, and the sums stay well scaled.
        point = cells.point - weight @ cells.point / weight.sum()
        (x, y, h), (u, v, w) = point.T, cells.normal.T
        arm = np.column_stack([cells.normal, y * w - h * v, h * u - x * w, x * v - y * u])
        shear = 0.5 / (1 + POISSON)
        K = (1 - shear) * (arm.T * weight) @ arm
        spread = (point.T * weight) @ point
        K[:3, :3] += shear * weight.sum() * np.eye(3)
        K[3:, 3:] += shear * (np.trace(spread) * np.eye(3) - spread)
        # In cells instead of metres, one bound serves both halves of the matrix: a section in one line turns freely.
        scale = np.repeat([1.0, 1.0 / CELL], 3)
        scaled = K * np.outer(scale, scale)
        if np.linalg.eigvalsh(scaled)[0] < 1e-9 * np.trace(scaled):
            return None
        motion = np.linalg.solve(K, _couples(self.mount.motor.peak_torque))  # (6, directions)
        # Every cell moves by the section's shift and turn; the part of it along the normal pulls, the rest shears.
        a, b, c = motion[3:]
        still = np.zeros(DIRECTIONS)
        moved = point @ np.concatenate([still, c, -b, -c, still, a, b, -a, still]).reshape(3, -1)
        moved += motion[:3].ravel()
        moved *= moved
        moved = moved.reshape(len(point), 3, DIRECTIONS)
        pull = arm @ motion
        pull *= pull
        pull *= 1 - 3 * shear**2
        square = pull + 3 * shear**2 * (moved[:, 0] + moved[:, 1] + moved[:, 2])
        return math.sqrt(float(square.max()))


@lru_cache(maxsize=8)
def _couples(peak_torque: float) -> Array:
    """No force and the couples of all directions as columns, (6, DIRECTIONS)."""
    return np.concatenate([np.zeros((3, DIRECTIONS)), superposed(load_cases(peak_torque)).T])


@lru_cache(maxsize=1)
def _circle() -> Array:
    """Directions of the cells around the axis, (AZIMUTHS, 2)."""
    return np.column_stack([np.cos(_angles()), np.sin(_angles())])


def _angles() -> Array:
    return np.asarray((np.arange(AZIMUTHS) + 0.5) * (2 * np.pi / AZIMUTHS), np.float64)


def _beside(samples: Mask) -> Mask:
    """Samples of a lattice and their neighbours along its axes."""
    out = samples.copy()
    for axis in range(3):
        there, here = np.moveaxis(out, axis, 0), np.moveaxis(samples, axis, 0)
        there[1:] |= here[:-1]
        there[:-1] |= here[1:]
    return out
