"""The strength of a mount: sections are beam theory in a straight limb, agree with finite elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blueprints import sampled
from numpy.typing import NDArray

from mfg import mount_sections, strength
from mfg.fields import Field
from mfg.mount_elasticity import mount_stress
from mfg.mount_sections import NOTCH, OWN, Sections
from mfg.mounts import motor_pose, mount_of
from mfg.parts import J60_6, PAPER
from mfg.strength import BENDING_SHARE, Half, Plastic, load_cases, superposed

MOUNT = mount_of(J60_6)
PLASTIC = Plastic.of(PAPER.rigid, PAPER.printer)
SOLID = replace(PLASTIC, infill=1.0)
ORIGIN, Z = np.zeros(3), np.array([0.0, 0.0, 1.0])


def limb(width: float, height: float, middle: float = 0.0, length: float = 0.16) -> Field:
    """A bar along x that begins inside the mount's ring, cut by the joint's cylinder, about the axis z."""

    def depth(p: NDArray[np.float64]) -> NDArray[np.float64]:
        half = np.array([length / 2, width / 2, height / 2])
        bar = (half - np.abs(p - np.array([length / 2, 0.0, middle]))).min(axis=-1)
        return np.minimum(bar, np.hypot(p[..., 0], p[..., 1]) - MOUNT.attach_radius)

    low = np.array([-0.03, -width / 2 - 0.02, middle - height / 2 - 0.02])
    return sampled(depth, low, np.array([length + 0.03, width / 2 + 0.02, middle + height / 2 + 0.02]))


def sections(bone: Field, plastic: Plastic = PLASTIC, reach: float = 0.02) -> Sections:
    return Sections.sample(bone, ORIGIN, Z, MOUNT, plastic, reach)


def test_loads_are_the_peak_torque_and_a_couple_across_it_in_every_direction() -> None:
    combined = superposed(load_cases(J60_6.peak_torque))
    np.testing.assert_allclose(combined[:, 2], J60_6.peak_torque)
    np.testing.assert_allclose(np.linalg.norm(combined[:, :2], axis=1), BENDING_SHARE * J60_6.peak_torque)


def test_in_a_straight_limb_a_section_is_the_beam_formula(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torque about z bends a limb along x: sigma = T (w / 2) / I with I = h w^3 / 12, as every beam has it.

    The couple across adds M (h / 2) / (w h^3 / 12) where it bends and a twist where it turns the limb. Cells are 5 mm,
    so the outermost fibre that is seen lies half a cell below the surface.
    """
    w, h = 0.06, 0.05
    monkeypatch.setattr(mount_sections, "NOTCH", {"holder": 1.0, "connector": 1.0})
    monkeypatch.setattr(mount_sections, "OWN", {"holder": 0.0, "connector": 0.0})
    monkeypatch.setattr(strength, "BENDING_SHARE", 0.0)
    mount_sections._couples.cache_clear()
    try:
        found = sections(limb(w, h, middle=-0.003), SOLID).stress(0.0, "holder")
    finally:
        mount_sections._couples.cache_clear()
    beam = J60_6.peak_torque * (w / 2) / (h * w**3 / 12)
    assert found == pytest.approx(beam, rel=0.20)


def test_twice_the_torque_is_twice_the_stress_and_half_the_safety() -> None:
    strong = replace(J60_6, peak_torque=2 * J60_6.peak_torque)
    bone = limb(0.05, 0.05)
    once = sections(bone).stress(0.0, "holder")
    twice = Sections.sample(bone, ORIGIN, Z, mount_of(strong), PLASTIC, 0.02).stress(0.0, "holder")
    assert twice == pytest.approx(2 * once, rel=1e-9)


@pytest.mark.parametrize("half", ["holder", "connector"])
def test_a_thicker_limb_and_thicker_walls_are_stronger(half: Half) -> None:
    middle = 0.0 if half == "holder" else 0.0385
    thin, thick = (sections(limb(width, 0.05, middle)).safety(0.0, half) for width in (0.03, 0.06))
    assert 0 < thin < thick
    walls = replace(PLASTIC, wall=2 * PLASTIC.wall)
    assert sections(limb(0.06, 0.05, middle), walls).safety(0.0, half) > thick


def test_what_was_found_for_one_plastic_serves_another() -> None:
    bone = limb(0.05, 0.05)
    first = sections(bone)
    assert np.isfinite(first.stress(0.0, "holder"))
    again = replace(first, plastic=SOLID)
    assert again.cells is first.cells
    assert again.stress(0.0, "holder") == sections(bone, SOLID).stress(0.0, "holder") < first.stress(0.0, "holder")


def test_nothing_holds_a_mount_that_no_bone_touches() -> None:
    far = limb(0.05, 0.03, middle=0.12)
    assert sections(far, reach=0.08).safety(0.0, "holder") == 0.0
    assert mount_stress(far, np.eye(4), MOUNT, "holder", PLASTIC, 8e-3).safety == 0.0


def test_a_stub_that_its_bone_does_not_continue_holds_nothing() -> None:
    """A lump of bone on the mount that no material joins to the rest."""

    def depth(p: NDArray[np.float64]) -> NDArray[np.float64]:
        bar = (np.array([0.08, 0.03, 0.025]) - np.abs(p - np.array([0.08, 0.0, 0.0]))).min(axis=-1)
        gap = np.abs(p[..., 0] - 0.065) - 0.006
        return np.minimum(np.minimum(bar, gap), np.hypot(p[..., 0], p[..., 1]) - MOUNT.attach_radius)

    bone = sampled(depth, np.array([-0.03, -0.05, -0.045]), np.array([0.19, 0.05, 0.045]))
    assert sections(bone).safety(0.0, "holder") == 0.0
    assert mount_stress(bone, np.eye(4), MOUNT, "holder", PLASTIC, 5e-3).safety == 0.0


def test_a_flipped_motor_in_a_mirrored_bone_is_the_same_mount() -> None:
    up = sections(limb(0.05, 0.04, middle=0.0385)).safety(0.0, "connector")
    down = sections(limb(0.05, 0.04, middle=-0.0385)).safety(0.0, "connector", flipped=True)
    assert down == pytest.approx(up, rel=0.08)  # the cells do not mirror onto cells
    assert sections(limb(0.05, 0.04, middle=0.0385)).safety(0.0, "connector", flipped=True) == 0.0


def test_stopping_early_never_changes_the_verdict() -> None:
    for width in (0.02, 0.03, 0.045, 0.07):
        found = sections(limb(width, 0.05))
        whole = found.safety(0.0, "holder")
        for least in (0.5, 1.0, 2.0, 4.0):
            assert (found.safety(0.0, "holder", least=least) >= least) == (whole >= least)


@pytest.mark.parametrize(("width", "half", "walls"), [(0.03, "holder", 3), (0.07, "holder", 3), (0.06, "connector", 3),
                                                      (0.06, "connector", 6)])  # fmt: skip
def test_sections_and_finite_elements_agree_and_sections_are_the_careful_side(
    width: float, half: Half, walls: int
) -> None:
    plastic = Plastic.of(replace(PAPER.rigid, walls=walls), PAPER.printer)
    bone = limb(width, 0.06, middle=0.0 if half == "holder" else 0.035)
    fast = sections(bone, plastic).safety(0.0, half)
    fine = mount_stress(bone, motor_pose(ORIGIN, Z, 0.0), MOUNT, half, plastic, 5e-3).safety
    assert 0.25 * fine < fast < 1.0 * fine


def test_finite_elements_hardly_depend_on_the_grid() -> None:
    bone = limb(0.06, 0.06)
    coarse, fine = (mount_stress(bone, np.eye(4), MOUNT, "holder", PLASTIC, h).safety for h in (6e-3, 4.5e-3))
    assert coarse == pytest.approx(fine, rel=0.2)


def test_walls_and_infill_make_the_stiffness() -> None:
    depth = np.array([-0.01, 0.0009, 0.02], np.float32)
    np.testing.assert_allclose(PLASTIC.stiffness(depth, 1e-4), [0.0, 1.0, PAPER.rigid.infill**2], atol=1e-9)
    assert PLASTIC.wall == pytest.approx(3 * 0.62e-3)
    assert set(NOTCH) == set(OWN) == {"holder", "connector"}
