"""Elasticity on voxels: rigid motion costs nothing, the patch test, and published beams, bars and plates."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mfg.voxel_elasticity import VoxelModel, von_mises

E, NU = 2.4e9, 0.35
Array = NDArray[np.float64]


def block(*shape: int, spacing: float = 2e-3) -> VoxelModel:
    return VoxelModel.of(np.full(shape, E), spacing, NU)


def test_rigid_motion_strains_nothing_and_a_uniform_strain_is_uniform() -> None:
    model, rng = block(2, 3, 2), np.random.default_rng(0)
    points = model.points()
    turn = rng.normal(size=3)
    np.testing.assert_allclose(model.strains((rng.normal(size=3) + np.cross(turn, points))[None]), 0, atol=1e-12)
    slope = rng.normal(size=(3, 3))
    strain = model.strains((points @ slope.T)[None])
    s = slope + slope.T
    expected = [*np.diag(slope), s[0, 1], s[1, 2], s[2, 0]]
    np.testing.assert_allclose(strain, np.broadcast_to(expected, strain.shape), atol=1e-10)


def test_pulled_bar_is_exact_in_any_cut() -> None:
    """Uniaxial stress with free sides: elongation F L / (E A), side contraction by Poisson's ratio (patch test)."""
    model = block(5, 3, 2)
    points = model.points()
    length, area, pull = 10e-3, 24e-6, 100.0
    forces = np.zeros((1, len(points), 3))
    end = np.isclose(points[:, 0], length)
    # Consistent loads of a uniform traction: a corner of the face carries a quarter of each cell it touches.
    touches = np.bincount(model.corner[model.cells[:, 0] == 4][:, 4:].ravel(), minlength=len(points))
    forces[0, :, 0] = pull * touches / touches.sum()
    assert (forces[0, ~end] == 0).all()
    symmetric = np.zeros(len(points), bool)
    moved = _solved_with_rollers(model, forces, points, symmetric)
    assert moved[end, 0] == pytest.approx(pull * length / (E * area), rel=1e-9)
    side = np.isclose(points[:, 1], 6e-3)
    assert moved[side, 1] == pytest.approx(-NU * pull / (E * area) * 6e-3, rel=1e-9)
    assert von_mises(model.strains(moved[None]), E, NU) == pytest.approx(pull / area, rel=1e-9)


def _solved_with_rollers(model: VoxelModel, forces: Array, points: Array, held: NDArray[np.bool_]) -> Array:
    """Hold only x on the face x = 0, y on y = 0 and z on z = 0."""
    fixed = np.repeat(held, 3).reshape(-1, 3) | np.isclose(points, 0)
    free = np.flatnonzero(~fixed.ravel())
    K = model._stiffness()[free][:, free].toarray()
    moved = np.zeros(fixed.size)
    moved[free] = np.linalg.solve(K, forces.ravel()[free])
    return moved.reshape(-1, 3)


@pytest.mark.parametrize(("across", "spacing"), [(2, 5e-3), (4, 2.5e-3), (8, 1.25e-3)])
def test_cantilever_matches_timoshenko(across: int, spacing: float) -> None:
    """Tip load on a square cantilever: w = F L^3 / (3 E I) + F L / (k G A), sigma = F (L - x) z / I.

    Source: S. P. Timoshenko, Strength of Materials; shear coefficient k of a square, G. R. Cowper 1966:
    10 (1 + nu) / (12 + 11 nu).
    """
    h, slenderness, F = across * spacing, 6, 50.0
    L = slenderness * h
    model = block(slenderness * across, across, across, spacing=spacing)
    points = model.points()
    tip = np.isclose(points[:, 0], L)
    forces = np.zeros((1, len(points), 3))
    forces[0, tip, 2] = F / tip.sum()
    moved = model.displacements(forces, np.isclose(points[:, 0], 0))
    assert moved is not None
    inertia, area, G = h**4 / 12, h**2, E / (2 * (1 + NU))
    k = 10 * (1 + NU) / (12 + 11 * NU)
    theory = F * L**3 / (3 * E * inertia) + F * L / (k * G * area)
    assert moved[0, tip, 2].mean() == pytest.approx(theory, rel=0.04)
    # Stress at a Gauss point of the top layer, in the middle of the beam, away from both ends.
    strain = model.strains(moved)[0]
    middle = (model.cells[:, 0] == slenderness * across // 2) & (model.cells[:, 2] == across - 1)
    along, height = (slenderness * across // 2 + 0.5) * spacing, h / 2 - spacing / 2 * (1 - 1 / np.sqrt(3))
    upper = strain[middle][:, 1::2]
    bending = F * (L - along) * height / inertia
    assert (E * np.abs(upper[..., 0])).mean() == pytest.approx(bending, rel=0.05)


@pytest.mark.parametrize("across", [10, 14])
def test_torsion_of_a_square_bar_matches_saint_venant(across: int) -> None:
    """Twist per length T / (G 0.1406 a^4), greatest shear stress T / (0.208 a^3) (Timoshenko & Goodier, art. 109)."""
    a, T = 20e-3, 3.0
    spacing = a / across
    count = 4 * across
    model = block(count, across, across, spacing=spacing)
    points = model.points()
    arm = points - np.array([0, a / 2, a / 2])
    end = np.isclose(points[:, 0], 4 * a)
    forces = np.zeros((1, len(points), 3))
    swirl = np.cross([1.0, 0, 0], arm) * end[:, None]
    forces[0] = swirl * T / np.cross(arm, swirl)[:, 0].sum()
    moved = model.displacements(forces, np.isclose(points[:, 0], 0))
    assert moved is not None
    # Twist between the quarter points, clear of the held end and of the load.
    angle = []
    for x in (a, 3 * a):
        rim = np.isclose(points[:, 0], x)
        v = np.cross(arm[rim], moved[0, rim])[:, 0].sum() / np.square(arm[rim, 1:]).sum()
        angle.append(v)
    G = E / (2 * (1 + NU))
    assert (angle[1] - angle[0]) / (2 * a) == pytest.approx(T / (G * 0.1406 * a**4), rel=0.04)
    middle = (model.cells[:, 0] == count // 2)[:, None] & np.ones((1, 8), bool)
    shear = von_mises(model.strains(moved)[0], E, NU)[middle].max() / np.sqrt(3)
    # The greatest stress lies at the middle of a side; the outermost Gauss point lies a fifth of a cell below it.
    assert shear == pytest.approx(T / (0.208 * a**3), rel=0.10)


def test_annular_plate_clamped_outside_under_a_line_load_inside() -> None:
    """Ring load on the free inner edge of an annular plate held at its outer edge.

    Kirchhoff theory, solved here from its general axisymmetric solution (Timoshenko & Woinowsky-Krieger, art. 17):
    w = c1 + c2 r^2 + c3 ln r + P r^2 ln r / (8 pi D), with w = w' = 0 outside, no moment and a shear force of
    P / (2 pi b) inside; plus the shear deflection P ln(a / b) / (2 pi k G t) with k = 5 / 6.
    """
    outer, inner, t, P = 60e-3, 20e-3, 6e-3, 40.0
    spacing = 2e-3
    n = round(2 * outer / spacing)
    centre = (np.arange(n) + 0.5) * spacing - outer
    radius = np.hypot(centre[:, None], centre[None, :])
    plate = (radius < outer + 2 * spacing) & (radius > inner)
    model = VoxelModel.of(np.where(plate[:, :, None], E, 0.0) * np.ones((1, 1, 3)), spacing, NU)
    points = model.points() - np.array([outer, outer, 0])
    r = np.hypot(points[:, 0], points[:, 1])
    rim = r < inner + 0.75 * spacing
    forces = np.zeros((1, len(points), 3))
    forces[0, rim, 2] = P / rim.sum()
    moved = model.displacements(forces, r > outer - 0.5 * spacing)
    assert moved is not None
    D, G = E * t**3 / (12 * (1 - NU**2)), E / (2 * (1 + NU))
    p = P / (8 * np.pi * D)
    a, b = outer, inner

    def slope(q: float) -> Array:
        return np.array([2 * q, 1 / q])

    def moment(q: float) -> Array:  # w'' + nu w' / r
        return np.array([2 + 2 * NU, (-1 + NU) / q**2])

    c2, c3 = np.linalg.solve(
        np.stack([slope(a), moment(b)]),
        -p * np.array([a * (2 * np.log(a) + 1), (2 * np.log(b) + 3) + NU * (2 * np.log(b) + 1)]),
    )
    w = [c2 * q**2 + c3 * np.log(q) + p * q**2 * np.log(q) for q in (a, b)]
    theory = abs(w[1] - w[0]) + P * np.log(a / b) / (2 * np.pi * 5 / 6 * G * t)
    assert moved[0, rim, 2].mean() == pytest.approx(theory, rel=0.10)


def test_direct_and_iterative_solutions_agree() -> None:
    rng = np.random.default_rng(3)
    modulus = np.where(rng.random((14, 10, 8)) < 0.9, rng.uniform(0.05, 1.0, (14, 10, 8)), 0.0) * E
    modulus[0] = E
    large = VoxelModel.of(modulus, 3e-3, NU)
    pieces = large.nodes[:, 0] == 0
    forces = np.zeros((2, len(large.nodes), 3))
    forces[0, large.nodes[:, 0] == 14, 1] = 1.0
    forces[1, large.nodes[:, 0] == 14, 0] = 1.0
    iterated = large.displacements(forces, pieces)
    import scipy.sparse.linalg as direct

    free = np.flatnonzero(~np.repeat(pieces, 3))
    assert len(free) > 4000  # so that it really iterates
    K = large._stiffness()[free][:, free].tocsc()
    exact = direct.splu(K).solve(forces.reshape(2, -1)[:, free].T).T
    assert iterated is not None
    found = iterated.reshape(2, -1)[:, free]
    assert np.abs(found - exact).max() < 2e-3 * np.abs(exact).max()
