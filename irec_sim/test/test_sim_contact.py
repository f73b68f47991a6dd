# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_sim.cellfile import Patch, read_cell
from irec_sim.contact import RING_PRESSURE, RING_STIFFNESS, Contact, Disc, contact_force, solve_contact
from irec_sim.mesh import Mesh

DISC = Disc()
NORMAL = np.array([0.6, 0.0, 0.8])
COMPLIANCE = np.array([[6e-7, 1e-7, 0.0], [1e-7, 9e-7, 2e-7], [0.0, 2e-7, 8e-7]])


def plane(p):
    """Tooling below the plane through the origin."""
    return float(p @ NORMAL), NORMAL


def _touching(depth=2e-4):
    return contact_force(DISC, plane, -depth * NORMAL, Contact())[2]


def test_nothing_touches_nothing_pushes():
    force, derivative, after = contact_force(DISC, plane, 1e-6 * NORMAL, _touching())
    assert not force.any() and not derivative.any() and not after.touching


points = st.lists(st.floats(-8e-4, 8e-4), min_size=3, max_size=3).map(np.array)


@given(points)
def test_force_only_pushes_stays_in_the_friction_cone_and_vanishes_off_the_surface(p):
    force, _, _ = contact_force(DISC, plane, p, _touching())
    gap, n = plane(p)
    pressure = force @ n
    assert pressure >= 0.0
    assert (pressure == 0.0) == (gap >= 0.0)
    assert np.linalg.norm(force - pressure * n) <= DISC.friction * pressure * (1 + 1e-9) + 1e-12


@given(points)
def test_a_ring_slips_only_at_its_friction_limit(p):
    memory = _touching()
    force, _, after = contact_force(DISC, plane, p, memory)
    if not after.touching:
        return
    _, n = plane(p)
    across = p - memory.anchors
    across -= (across @ n)[:, None] * n
    held = p - after.anchors
    held -= (held @ n)[:, None] * n
    slipped = np.linalg.norm(across - held, axis=1)
    pull = DISC.tangential * RING_STIFFNESS * np.linalg.norm(held, axis=1)
    room = DISC.friction * RING_PRESSURE * (force @ n) - pull
    assert (room > -1e-6).all()
    assert np.all((slipped < 1e-12) | (room < 1e-6))


def test_friction_opposes_the_slip():
    memory = _touching()
    force, _, _ = contact_force(DISC, plane, np.array([0.0, 5e-3, 0.0]) - 2e-4 * NORMAL, memory)
    assert force[1] < 0.0
    assert abs(force[1]) == pytest.approx(DISC.friction * (force @ NORMAL), rel=1e-9)


def test_tangential_stiffness_falls_ring_by_ring():
    memory, p = _touching(), -2e-4 * NORMAL
    way = np.linspace(0.0, 6e-4, 60)
    pull = np.array([-contact_force(DISC, plane, p + [0.0, y, 0.0], memory)[0][1] for y in way])
    slope = np.diff(pull)
    assert (np.diff(slope) < 1e-6).all()
    assert slope[0] == pytest.approx(DISC.tangential * (way[1] - way[0]), rel=1e-6)
    assert len(np.unique(np.round(slope / slope[0], 3))) >= 4


@given(points, st.integers(0, 2))
@settings(max_examples=60)
def test_the_derivative_of_the_force_is_right(p, k):
    memory, h = _touching(), 1e-10
    step = np.zeros(3)
    step[k] = h
    gap, _ = plane(p)
    if abs(gap) < 1e-6:
        return
    _, derivative, middle = contact_force(DISC, plane, p, memory)
    plus, minus = (contact_force(DISC, plane, p + s * step, memory) for s in (1, -1))

    def branches(x):
        return np.abs(x.anchors - memory.anchors).max(axis=1) > 1e-12

    if not (np.array_equal(branches(plus[2]), branches(minus[2])) and np.array_equal(branches(plus[2]), branches(middle))):
        return  # on an edge there is no derivative
    assert np.allclose((plus[0] - minus[0]) / (2 * h), derivative[:, k], rtol=1e-3, atol=5e3)


@given(points)
def test_disc_and_arm_meet_in_equilibrium(p_free):
    memory = _touching()
    force, after = solve_contact(DISC, plane, p_free, COMPLIANCE, memory, np.zeros(3))
    again, _, _ = contact_force(DISC, plane, p_free + COMPLIANCE @ force, memory)
    assert np.abs(again - force).max() < 0.1
    assert after.touching == bool(force.any())


def test_pressing_and_letting_go_leaves_no_memory_of_slip():
    memory = _touching()
    _, _, dragged = contact_force(DISC, plane, np.array([0.0, 5e-3, 0.0]) - 2e-4 * NORMAL, memory)
    _, _, gone = contact_force(DISC, plane, 1e-3 * NORMAL, dragged)
    force, _, _ = contact_force(DISC, plane, -2e-4 * NORMAL, gone)
    assert np.abs(force - (force @ NORMAL) * NORMAL).max() < 1e-9


def test_the_contact_works_on_the_mould():
    cell = read_cell("afp")
    p, n = (x[0] for x in cell.surface.sample(1, 0.1, np.random.default_rng(0)))
    force, _, _ = contact_force(DISC, cell.surface.gap, p - 2e-4 * n, Contact())
    assert force @ n == pytest.approx(np.linalg.norm(force), rel=1e-6)
    assert 700.0 < force @ n < 1000.0


def test_a_mesh_and_the_patch_that_it_stands_for_have_the_same_gap_and_normal():
    patch = Patch((1.0, 1.6), (2.0, 2.5), np.eye(3), np.array([1.0, 0.0, 0.5]))
    u, v = np.linspace(-0.5, 0.5, 41), np.linspace(-0.8, 0.8, 65)
    p = patch.point(*(g.ravel() for g in np.meshgrid(u, v, indexing="ij")))[0].reshape(41, 65, 3)
    quads = [(p[i, j], p[i + 1, j], p[i + 1, j + 1], p[i, j + 1]) for i in range(40) for j in range(64)]
    mesh = Mesh(np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
    rng = np.random.default_rng(2)
    for x, y, height in rng.uniform((-0.4, -0.7, -0.003), (0.4, 0.7, 0.003), (30, 3)):
        surface, normal = (a[0] for a in patch.point(np.array([x]), np.array([y])))
        gap, n = mesh.gap(surface + height * normal)
        assert gap == pytest.approx(height, abs=1.2e-4)  # facets of 25 mm on radii of 2 m lie 40 um inside
        assert float(n @ normal) > 0.9999
