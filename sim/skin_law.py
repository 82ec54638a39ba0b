"""How stiff the printed soft skin is, from its filament, infill and wall; no simulator in here."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mfg.description import SkinMaterial
from mfg.robot_files import CONTACT_TIME

PATCH = 1.0e-3  # (assumed) area over which the floor presses a skin [m2]
INFILL_FACTOR = 1.0  # C of Gibson and Ashby's law for open cells
WALL_POISSON = 0.45  # (assumed) of solid TPU
POISSON = 0.1  # (assumed) of the skin as a whole: sparse cells that fold hardly swell; from 0.2 on blocks turn unstable
DAMPING_TIME = 0.001  # (assumed) damping over stiffness of the skin [s]: a loss factor of about 0.05 at 8 Hz
BARE = 0.002  # thinner skin counts as bare bone: it is hardly more than its wall [m]
CONTACTS = 2.5  # corners of a hull that share the load of a link, fitted to the sag of blocks (docs/fidelity.md)
IMPEDANCE = 0.95  # MuJoCo's default for a contact deeper than a millimetre
FIRM_CONTACT_TIME = 0.01  # of a surface whose softness is modelled beneath it [s]


@dataclass(frozen=True, eq=False, slots=True)
class Cover:
    """A link and the skin over it, in the link's frame.

    Attributes:
        name: of the body and of the geom that is its hull.
        thickness: of the skin [m]; below `BARE` it is bare bone.
        hull: corners of its convex hull [m], (n, 3).
        mass: of the link with its skin [kg].
        com: its centre [m], (3,).
        inertia: about the centre [kg.m2], (3, 3).
        at_end: whether it is the last link of a limb.
        inverse_mass: mean acceleration of the link per force on it while the joints are free [1/kg].
    """

    name: str
    thickness: float
    hull: NDArray[np.float64]
    mass: float
    com: NDArray[np.float64]
    inertia: NDArray[np.float64]
    at_end: bool
    inverse_mass: float

    @property
    def is_soft(self) -> bool:
        """Whether there is skin to speak of."""
        return self.thickness >= BARE

    @property
    def radius(self) -> float:
        """Half the middle extent of the hull: how strongly its surface is curved [m]."""
        return float(np.sort(np.ptp(self.hull, axis=0))[1]) / 2


def effective_modulus(material: SkinMaterial, thickness: float, radius: float, patch: float = PATCH) -> float:
    """Modulus of a uniform layer that yields as much under a patch as the printed skin does [Pa].

    Infill alone has E_i = C E phi^2 (L. J. Gibson, M. F. Ashby, Cellular Solids, 1997, chapter 5: the walls of open
    cells bend; C = 1). The perimeter is a shallow shell of thickness t and radius R on that elastic foundation, which
    acts like a plate on a foundation of modulus b = E_i / h + E t / R^2 (E. Reissner, Stresses and small displacements
    of shallow spherical shells, 1946) and resists a force at a point by 8 sqrt(b D) per deflection (S. Timoshenko,
    S. Woinowsky-Krieger, Theory of Plates and Shells, 1959, article 57), with D = E t^3 / (12 (1 - nu^2)). That the two
    shares add up to k = b A + 8 sqrt(b D) for a patch of any size is (assumed). E_eff = k h / A.

    Args:
        material: of the skin: E, t, phi.
        thickness: h, of the skin [m].
        radius: R, of the surface [m].
        patch: A [m2].
    """
    E, t, h = material.youngs_modulus, material.wall, thickness
    foundation = INFILL_FACTOR * E * material.infill**2 / h + E * t / radius**2
    bending = E * t**3 / (12.0 * (1.0 - WALL_POISSON**2))
    return (foundation * patch + 8.0 * math.sqrt(foundation * bending)) * h / patch


def pad_stiffness(material: SkinMaterial, thickness: float, radius: float, patch: float = PATCH) -> float:
    """Force per deflection of a patch of skin, k = E_eff A / h [N/m]."""
    return effective_modulus(material, thickness, radius, patch) * patch / thickness


def contact_time(stiffness: float, inverse_mass: float, contacts: float = CONTACTS) -> float:
    """What makes contacts of a given stiffness in MuJoCo: time constant times damping ratio of their `solref` [s].

    MuJoCo's contact is no spring of the material: at rest one of depth r bears f = r / (T^2 (1 - d) W), with T that
    product, its impedance d and the inverse mass W of the body (manual: Modeling, Solver parameters). So the same skin
    needs another T on every link, T = sqrt(n / ((1 - d) W k)).

    Args:
        stiffness: k, of all contacts of the link together [N/m].
        inverse_mass: W, of the link [1/kg].
        contacts: n, how many share the load.
    """
    return math.sqrt(contacts / ((1.0 - IMPEDANCE) * stiffness * inverse_mass))


def cover_stiffness(cover: Cover, material: SkinMaterial) -> float:
    """`pad_stiffness` of a link's skin [N/m]."""
    return pad_stiffness(material, cover.thickness, cover.radius)


def fitted_solref(cover: Cover, material: SkinMaterial) -> tuple[float, float]:
    """Time constant [s] and damping ratio that give the contact of a soft link the stiffness of its skin.

    The time constant is that of friction, too, which a soft one lets creep; so softness beyond `CONTACT_TIME` comes
    from the damping ratio.
    """
    product = max(FIRM_CONTACT_TIME, contact_time(cover_stiffness(cover, material), cover.inverse_mass))
    time = min(product, CONTACT_TIME)
    return time, product / time


def skin_mass(cover: Cover, material: SkinMaterial) -> float:
    """Mass of a link's skin [kg]: hull area x (wall + infill x thickness) x density, at most half of the link."""
    area = float(ConvexHull(cover.hull).area)
    spread = material.wall + material.infill * cover.thickness
    return min(area * spread * material.density, cover.mass / 2)
