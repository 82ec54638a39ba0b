"""Will a motor's mount hold the motor's peak torque? What loads it, what it is printed of, and where its halves end.

The load of both halves of a mount is the peak torque about the axis and, at the same time, a couple across it in the
worst direction. `mfg.mount_elasticity` turns it into stress by finite elements, `mfg.mount_sections` by sections, about
a thousand times faster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mfg.catalogue import Filament, Printer
from mfg.fields import coverage
from mfg.mounts import Mount

Array = NDArray[np.float64]
Half = Literal["holder", "connector"]

# Tensile strength of printed PLA across its layers, its weakest way [Pa]: 22.8 MPa on average, with a stiffness of
# 2.4 GPa (3D Printing and Additive Manufacturing, doi 10.1089/3dp.2020.0109). Taken for every direction, because a
# mount is loaded in all of them and its way up on the printer is chosen later.
LAYER_STRENGTH = 22.8e6
POISSON = 0.35  # of PLA (assumed), typical of glassy polymers
# Young's modulus of infill over that of its plastic is its share squared (assumed): the law of open cells (Gibson &
# Ashby, Cellular Solids, ch. 5); gyroid PLA lattices were measured at 1 % to 12 % of the bulk.
INFILL_POWER = 2.0
# Couple across the axis over the peak torque (assumed): the force that makes the peak torque at the end of a limb acts
# beside the plane in which the joint turns, by a quarter of its lever arm (50 mm beside a limb of 0.2 m).
BENDING_SHARE = 0.25
DIRECTIONS = 8  # of that couple, all around

# What counts as the body that holds a mount, for both ways to compute its stress.
BODY_SHARE = 0.5  # of a bone may lie nearer to the mount; the rest is the body
PIECE = 0.10  # least share of a bone that is its body; a smaller piece out there is a lump that nothing holds


@dataclass(frozen=True, slots=True)
class Plastic:
    """A printed material as its walls and infill make it.

    Attributes:
        modulus: of the plastic [Pa].
        strength: von Mises stress at which a printed part breaks [Pa].
        wall: thickness of the walls [m].
        infill: modulus of the infill over that of the plastic.
    """

    modulus: float
    strength: float
    wall: float
    infill: float

    @staticmethod
    def of(filament: Filament, printer: Printer, strength: float = LAYER_STRENGTH) -> Plastic:
        """The plastic of a filament as this printer lays it down."""
        return Plastic(
            filament.youngs_modulus, strength, filament.walls * printer.line_width, filament.infill**INFILL_POWER
        )

    def stiffness(self, depth: NDArray[np.float32], width: float) -> Array:
        """Effective modulus over that of the plastic, of cells of this width by the depth at their middle [m].

        Walls of the stated thickness along the surface, infill inside of them, nothing outside.
        """
        filled = coverage(depth, width).astype(np.float64)
        inner = coverage(depth - np.float32(self.wall), width).astype(np.float64)
        return np.asarray(filled - (1 - self.infill) * inner)


def load_cases(peak_torque: float) -> Array:
    """Couples on the mount in its frame [N.m], (3, 3): the peak torque about z, the bending share about x and y."""
    return peak_torque * np.diag([BENDING_SHARE, BENDING_SHARE, 1.0])[[2, 0, 1]]


def superposed(response: Array) -> Array:
    """Responses (3, ...) to the three load cases, combined for every direction of bending, (DIRECTIONS, ...)."""
    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    mix = np.stack([np.ones(DIRECTIONS), np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(np.tensordot(mix, response, axes=1), np.float64)


def safety_factor(stress: float, strength: float) -> float:
    """Strength over stress; 0 where the stress has no bound."""
    return strength / max(stress, 1.0) if np.isfinite(stress) else 0.0


def span(mount: Mount, half: Half) -> tuple[float, float, float]:
    """Radius, lower and upper end of one half of a mount [m], motor frame."""
    if half == "holder":
        return mount.holder_radius, mount.base_low, mount.holder_top
    return mount.connector_radius, mount.connector_low, mount.connector_high


def keepout(mount: Mount, half: Half) -> tuple[float, float, float]:
    """The cylinder that the body with this half leaves to the other one: radius, lower and upper end [m]."""
    if half == "holder":
        return mount.connector_radius + mount.clearance, mount.holder_top, mount.connector_high + mount.clearance
    return mount.holder_radius + mount.clearance, mount.base_low - mount.clearance, mount.connector_low
