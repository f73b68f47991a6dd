# SPDX-License-Identifier: Apache-2.0
"""The plant against first principles: each joint as real rotations in plain matrices, energy, symmetry, reciprocity."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_sim.cellfile import read_cell
from irec_sim.equilibrium import Equilibrium
from irec_sim.errors import SimError
from irec_sim.kinematics import forward, rotation
from irec_sim.laws import GearCurve, Maxwell, play, presliding
from irec_sim.parameters import Balancer, Hose, PlantParameters
from irec_sim.plant import Conditions, Plant
from irec_sim.terms import Term
from scipy.integrate import solve_ivp

CHAIN = read_cell("afp").chain
AXIAL = np.array([2.2e-7, 2.0e-7, 2.5e-7, 1.2e-6, 1.3e-6, 2.1e-6])
TRANSVERSE = np.outer(AXIAL, [0.1, 0.2])
PLAIN = PlantParameters(AXIAL, TRANSVERSE)
OFF_CENTRE = replace(PLAIN, centre=np.random.default_rng(1).normal(0.0, 0.05, (6, 3)))
SPRUNG = replace(PLAIN, base=np.array([1e-9, 2e-9, 3e-9, 1e-8, 2e-8, 3e-8]), tool=np.array([1e-8, 2e-8, 5e-9, 2e-7, 1e-7, 3e-7]))
Q = np.array([[0.2, -1.4, 1.6, 0.3, 0.9, 0.4]])
FORCE = np.array([[280.0, -150.0, -1100.0]])


def _transforms(plant, q, e):
    """Points of the arm by plain products of matrices: centres of mass and TCP, independent of Plant.frames."""
    chain, e = plant.chain, list(e)
    R, p = np.eye(3), np.zeros(3)

    def six():
        nonlocal R, p
        t, r = [e.pop(0) for _ in range(3)], [e.pop(0) for _ in range(3)]
        p = p + R @ np.array(t)
        for axis, angle in zip(np.eye(3), r, strict=True):
            R = R @ rotation(axis, angle)

    if plant.has_base:
        six()
    centres = []
    for k in range(chain.n):
        p = p + R @ chain.p_fixed[k]
        R = R @ chain.R_fixed[k] @ rotation(chain.axis[k], q[k] + e.pop(0))
        first = np.cross(chain.axis[k], np.eye(3)[int(np.argmin(np.abs(chain.axis[k])))])
        before, centre = R, plant.parameters.centre[k]
        R = R @ rotation(first, e.pop(0)) @ rotation(np.cross(chain.axis[k], first), e.pop(0))
        p = p + before @ centre - R @ centre  # the link bends about that point, which stays where it is
        centres.append(p + R @ chain.com[k])
    p = p + R @ chain.p_mount
    R = R @ chain.R_mount
    if plant.has_tool:
        six()
    centres.append(p + R @ chain.tool_com)
    return np.array(centres), p + R @ chain.p_tcp


def _potential(plant, q, e, force):
    """Energy of springs, weights and a dead force, J."""
    centres, tcp = _transforms(plant, q, e)
    masses = np.r_[plant.chain.mass, plant.chain.tool_mass]
    c = plant.compliance(q[None], Conditions.idle(1))
    c = np.broadcast_to(c, (1, plant.dof))[0]
    return 0.5 * (e**2 / c).sum() + 9.81 * (masses * centres[:, 2]).sum() - force @ tcp


@pytest.mark.parametrize("parameters", [SPRUNG, OFF_CENTRE])
@given(seed=st.integers(0, 2**31))
@settings(max_examples=6, deadline=None)
def test_torques_are_the_gradient_of_the_potential_energy(parameters, seed):
    rng = np.random.default_rng(seed)
    plant = Plant(CHAIN, parameters)
    q, e = Q[0] + rng.normal(0, 0.2, 6), rng.normal(0, 1e-3, plant.dof)
    frames = plant.frames(q[None], e[None])
    torque = (frames.weight_torque + (frames.lever @ FORCE[:, :, None])[..., 0])[0]
    for d in range(plant.dof):
        h = np.zeros(plant.dof)
        h[d] = 1e-6

        def work(x):
            centres, tcp = _transforms(plant, q, x)
            return -9.81 * (np.r_[CHAIN.mass, CHAIN.tool_mass] * centres[:, 2]).sum() + FORCE[0] @ tcp

        assert torque[d] == pytest.approx((work(e + h) - work(e - h)) / 2e-6, abs=2e-3)


@pytest.mark.parametrize("parameters", [SPRUNG, OFF_CENTRE])
def test_the_physical_tcp_is_where_plain_matrix_products_put_it(parameters):
    plant = Plant(CHAIN, parameters)
    e = np.random.default_rng(2).normal(0, 1e-3, plant.dof)
    assert np.allclose(plant.frames(Q, e[None]).p_tcp[0], _transforms(plant, Q[0], e)[1], atol=1e-13)


@pytest.mark.parametrize("parameters", [PLAIN, SPRUNG, OFF_CENTRE])
def test_equilibrium_is_a_minimum_of_the_potential_energy(parameters):
    plant = Plant(CHAIN, parameters)
    loaded = replace(Conditions.idle(1), force=FORCE)
    state, _ = plant.equilibrium(Q, loaded, plant.relaxed(Q))
    least = _potential(plant, Q[0], state.e[0], FORCE[0])
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = rng.normal(0, 1.0, plant.dof)
        step *= 1e-4 / np.linalg.norm(step)
        assert _potential(plant, Q[0], state.e[0] + step, FORCE[0]) > least


def _numeric_compliance(plant, at=None, h=20.0):
    idle = Conditions.idle(1)
    start = plant.relaxed(Q)
    force = np.zeros((1, 3)) if at is None else at
    out = np.zeros((3, 3))
    for k in range(3):
        step = np.zeros((1, 3))
        step[0, k] = h
        _, plus = plant.equilibrium(Q, replace(idle, force=force + step), start)
        _, minus = plant.equilibrium(Q, replace(idle, force=force - step), start)
        out[:, k] = (plus.p_tcp - minus.p_tcp)[0] / (2 * h)
    return out


@pytest.mark.parametrize("parameters", [PLAIN, SPRUNG, OFF_CENTRE])
@pytest.mark.parametrize("at", [None, FORCE])
def test_compliance_at_the_tcp_is_symmetric_and_positive(parameters, at):
    C = _numeric_compliance(Plant(CHAIN, parameters), at)
    assert np.abs(C - C.T).max() < 1e-6 * np.abs(C).max()
    assert np.linalg.eigvalsh(C).min() > 0.0


def test_small_loads_deflect_by_the_sum_over_springs_with_gravity_as_a_small_correction():
    plant = Plant(CHAIN, PLAIN)
    q = Q[0]
    rigid = forward(CHAIN, Q)
    C = np.zeros((3, 3))
    for k in range(6):
        axis, lever = rigid.axis[0, k], rigid.p_tcp[0] - rigid.origin[0, k]
        first = np.cross(CHAIN.axis[k], np.eye(3)[int(np.argmin(np.abs(CHAIN.axis[k])))])
        R = np.eye(3)
        for i in range(k + 1):
            R = R @ CHAIN.R_fixed[i] @ rotation(CHAIN.axis[i], q[i])
        for a, c in ((axis, AXIAL[k]), (R @ first, TRANSVERSE[k, 0]), (np.cross(axis, R @ first), TRANSVERSE[k, 1])):
            C += c * np.outer(np.cross(a, lever), np.cross(a, lever))
    assert np.abs(_numeric_compliance(plant, h=1.0) - C).max() < 0.01 * np.abs(C).max()


def test_work_done_by_one_load_on_the_displacement_of_another_is_reciprocal():
    plant = Plant(CHAIN, SPRUNG)
    a, b = np.array([[30.0, 0.0, 0.0]]), np.array([[0.0, 10.0, -40.0]])
    assert (a @ plant.deflection(Q, b)[0])[0] == pytest.approx((b @ plant.deflection(Q, a)[0])[0], rel=1e-3)


def test_large_loads_are_not_simply_the_sum_of_small_ones():
    plant = Plant(CHAIN, PLAIN)
    whole, tenth = plant.deflection(Q, FORCE)[0], plant.deflection(Q, FORCE / 10)[0]
    assert 1e-9 < np.linalg.norm(whole - 10 * tenth) < 1e-2 * np.linalg.norm(whole)


def test_a_batch_gives_what_single_rows_give():
    plant = Plant(CHAIN, replace(SPRUNG, friction=np.full(6, 0.1), backlash=np.full(6, 1e-5)))
    q = Q + np.random.default_rng(0).normal(0, 0.1, (5, 6))
    together = plant.deflection(q, np.tile(FORCE, (5, 1)))
    apart = np.concatenate([plant.deflection(q[i : i + 1], FORCE) for i in range(5)])
    assert np.abs(together - apart).max() < 1e-11


def _loop(plant, loads, dt=0.0):
    """Path of the TCP over a series of loads."""
    idle = Conditions.idle(1)
    state, path = plant.relaxed(Q), []
    for f in loads:
        state, frames = plant.equilibrium(Q, replace(idle, force=f * FORCE), state, dt)
        path.append(frames.p_tcp[0])
    return np.array(path)


def test_an_elastic_arm_forgets_the_path_of_its_load():
    path = _loop(Plant(CHAIN, SPRUNG), [1.0, 0.2, -0.5, 1.0])
    assert np.abs(path[3] - path[0]).max() < 1e-12


@pytest.mark.parametrize("form", ["sliders", "presliding"])
def test_friction_remembers_the_path_and_takes_energy(form):
    plant = Plant(CHAIN, replace(PLAIN, friction=np.full(6, 0.2), friction_form=form))
    loads = np.r_[np.linspace(0, 1, 20), np.linspace(1, -1, 40), np.linspace(-1, 1, 40)]
    path = _loop(plant, loads)
    assert np.linalg.norm(path[-1] - path[19]) < 0.05 * np.linalg.norm(path[19] - path[0])  # the loop closes
    cycle = slice(19, None)
    along = path[cycle] @ FORCE[0]
    f = loads[cycle]
    dissipated = np.sum(0.5 * (f[1:] + f[:-1]) * np.diff(along))
    assert dissipated > 1e-4


ONE = np.ones(1)


def test_presliding_friction_follows_its_differential_equation():
    compliance, limit, stiffness = 1e-6 * ONE, 100.0 * ONE, 4e6 * ONE
    wound, friction = presliding(np.array([[180.0]]), compliance, limit, stiffness, np.zeros((1, 1)), np.zeros((1, 1)))
    by_angle = solve_ivp(lambda w, f: stiffness * (1 - f / limit), (0, wound[0, 0]), [0.0], rtol=1e-10, atol=1e-10).y[0, -1]
    assert friction[0, 0] == pytest.approx(by_angle, rel=1e-6)
    assert wound[0, 0] / compliance[0] + friction[0, 0] == pytest.approx(180.0, rel=1e-9)


@given(st.lists(st.floats(-2000, 2000), min_size=1, max_size=12), st.floats(0.5, 20.0))
@settings(max_examples=60, deadline=None)
def test_presliding_friction_never_exceeds_its_limit_and_does_not_care_how_a_way_is_cut(torques, stiff):
    compliance, limit = 1e-6 * ONE, 300.0 * ONE
    stiffness = stiff / compliance
    state = np.zeros((1, 1)), np.zeros((1, 1))
    for tau in torques:
        begin = state
        state = presliding(np.array([[tau]]), compliance, limit, stiffness, *begin)
        half = presliding(np.array([[(tau + _carried(begin, compliance)) / 2]]), compliance, limit, stiffness, *begin)
        cut = presliding(np.array([[tau]]), compliance, limit, stiffness, *half)
        assert abs(state[1][0, 0]) <= limit[0] * (1 + 1e-9)
        assert cut[0][0, 0] == pytest.approx(state[0][0, 0], abs=1e-11)


def _carried(state, compliance):
    wound, friction = state
    return float((wound / compliance + friction)[0, 0])


def test_motion_frees_friction():
    plant = Plant(CHAIN, replace(PLAIN, friction=np.full(6, 0.3), release=1e-3, unrelaxed=0.8))
    idle = Conditions.idle(1)
    state = plant.relaxed(Q, idle, np.ones((1, 6)))
    _, frames = plant.equilibrium(Q, idle, state)
    free = plant.relaxed(Q, idle).memory["held"]
    held = [
        np.abs(plant.released(frames, Q, idle, state, np.full((1, 6), turn)).memory["held"] - free).max()
        for turn in (0.0, 1e-3, 1e-1)
    ]
    assert held[0] > 100.0 and held[1] == pytest.approx(held[0] * np.exp(-1), rel=0.02) and held[2] < 1e-2 * held[0]


@pytest.mark.parametrize("form", ["sliders", "presliding"])
def test_an_arm_that_comes_from_the_other_side_rests_elsewhere(form):
    plant = Plant(CHAIN, replace(PLAIN, friction=np.full(6, 0.3), friction_form=form, unrelaxed=0.8))
    idle = Conditions.idle(1)
    rest = [plant.equilibrium(Q, idle, plant.relaxed(Q, idle, s * np.ones((1, 6))))[1].p_tcp for s in (-1, 0, 1)]
    assert np.linalg.norm(rest[2] - rest[0]) > 1e-5
    assert np.abs(rest[0] + rest[2] - 2 * rest[1]).max() < 0.1 * np.abs(rest[2] - rest[0]).max()


def test_backlash_shows_as_a_step_where_the_torque_changes_sign():
    plain, played = Plant(CHAIN, PLAIN), Plant(CHAIN, replace(PLAIN, backlash=np.eye(6)[0] * 5e-5))
    side = np.array([[0.0, 300.0, 0.0]])
    extra = [played.deflection(Q, s * side)[0] - plain.deflection(Q, s * side)[0] for s in (-1.0, -0.5, 0.5, 1.0)]
    lever = np.linalg.norm(forward(CHAIN, Q).p_tcp[0, :2])
    assert np.allclose(np.linalg.norm(extra, axis=1), 5e-5 * lever, rtol=0.02)
    assert np.dot(extra[0], extra[3]) < 0


def test_play_is_taken_up_over_its_range_of_torque():
    share = np.linspace(-5, 5, 101)
    for sharpness in (1.5, 6.0):
        taken = play(share, sharpness)
        assert (np.diff(taken) > 0).all() and np.abs(taken).max() < 1.0
        assert np.allclose(taken, -taken[::-1])
    assert play(np.array([0.5]), 6.0) == pytest.approx(0.5, rel=0.01)
    assert play(np.array([0.5]), 1.5) < 0.45  # a blunt one never runs straight


def test_a_worn_bearing_tilts_its_link_to_the_side_of_the_load():
    gap = np.zeros((6, 2))
    gap[1] = 4e-5
    plain, worn = Plant(CHAIN, PLAIN), Plant(CHAIN, replace(PLAIN, bearing_gap=gap))
    side = np.array([[0.0, 600.0, 0.0]])
    extra = worn.deflection(Q, side)[0] - plain.deflection(Q, side)[0]
    assert extra[1] > 2e-5
    assert np.linalg.norm(worn.deflection(Q, 2 * side)[0] - plain.deflection(Q, 2 * side)[0]) < 1.5 * np.linalg.norm(extra)


CURVE = GearCurve(1, np.array([0.0, 100.0, 250.0, 600.0]), 2e-7 * np.array([1.0, 0.7, 0.1, 0.0]))


def test_a_gear_curve_is_the_integral_of_its_table_and_odd_and_never_falls():
    tau = np.linspace(-1000, 1000, 2001)
    angle = CURVE.angle(tau)
    assert (np.diff(angle) >= 0).all() and np.allclose(angle, -angle[::-1])
    slope = np.gradient(angle, tau)[1100]
    assert slope == pytest.approx(np.interp(100.0, CURVE.torque, CURVE.compliance), rel=0.02)
    area = (np.diff(CURVE.torque) * 0.5 * (np.array(CURVE.compliance[1:]) + np.array(CURVE.compliance[:-1]))).sum()
    assert angle[-1] == pytest.approx(area)


def test_a_gear_curve_makes_a_gear_softer_at_small_torque():
    plant = Plant(CHAIN, replace(PLAIN, curves=(CURVE,)))
    side = np.array([[0.0, 500.0, 0.0]])
    small, large = plant.deflection(Q, 0.05 * side)[0, 1] / 0.05, plant.deflection(Q, side)[0, 1]
    assert small > 1.2 * large


def test_creep_approaches_its_share():
    parameters = replace(PLAIN, creep=np.full(6, 0.3), creep_times=np.array([10.0]))
    plain, plant = Plant(CHAIN, replace(PLAIN)), Plant(CHAIN, parameters)
    start, loaded = plant.relaxed(Q), replace(Conditions.idle(1), force=FORCE)
    idle_frames = plant.equilibrium(Q, Conditions.idle(1), start)[1]
    at = {t: plant.equilibrium(Q, loaded, start, t)[1].p_tcp - idle_frames.p_tcp for t in (0.0, 13.0, 1e4)}
    assert np.allclose(at[0.0], plain.deflection(Q, FORCE), rtol=2e-3, atol=1e-7)
    share = np.linalg.norm(at[13.0] - at[0.0]) / np.linalg.norm(at[1e4] - at[0.0])
    assert share == pytest.approx(1 - np.exp(-1), rel=2e-2)  # a spring beside it slows the branch down by 1.3


def test_maxwell_branches_follow_their_differential_equations():
    share, weights, times = np.array([0.4]), np.array([0.5, 0.3, 0.2]), np.array([3.0, 12.0, 50.0])
    gear = Maxwell(share, weights, times)
    strain, branches = gear.after(np.array([[1.0]]), *gear.at_rest(np.array([[0.0]])), np.array([20.0]))
    stiff = share[0] / (1 + share[0]) * weights

    def rate(_, m):  # under constant torque: s (1 / (1 + share)) + sum m = 1
        return stiff * (m / times).sum() - m / times

    m = solve_ivp(rate, (0, 20.0), stiff, rtol=1e-10, atol=1e-12).y[:, -1]
    assert np.allclose(branches[0, 0], m, rtol=1e-6)
    assert strain[0, 0] == pytest.approx((1 - m.sum()) * (1 + share[0]), rel=1e-8)
    late, _ = gear.after(np.array([[1.0]]), strain, branches, np.array([1e5]))
    assert late[0, 0] == pytest.approx(1.4, rel=1e-6)


def test_creep_does_not_depend_on_how_time_is_cut():
    plant = Plant(CHAIN, replace(PLAIN, creep=np.full(6, 0.3), creep_times=np.array([4.0, 30.0]), creep_weights=np.full(2, 0.5)))
    loaded = replace(Conditions.idle(1), force=FORCE)
    whole, _ = plant.equilibrium(Q, loaded, plant.relaxed(Q), 8.0)
    state = plant.relaxed(Q)
    for _ in range(8):
        state, _ = plant.equilibrium(Q, loaded, state, 1.0)
    assert np.allclose(state.e, whole.e, rtol=1e-3, atol=1e-9)


def test_coupled_wrist_gears_keep_the_compliance_symmetric():
    coupling = np.zeros((6, 6))
    coupling[3, 4] = coupling[4, 3] = 4e-7
    C = _numeric_compliance(Plant(CHAIN, replace(PLAIN, coupling=coupling)))
    assert np.abs(C - C.T).max() < 1e-6 * np.abs(C).max()


def test_a_balancer_stiffens_axis_2_where_its_lever_is_long():
    balancer = Balancer(stiffness=3e7)
    plant = Plant(CHAIN, replace(PLAIN, balancer=balancer))
    q = np.linspace(-2.4, -0.2, 12)
    c2 = plant.compliance(np.column_stack([q * 0, q, q * 0, q * 0, q * 0, q * 0]), Conditions.idle(12))[:, plant.axial[1]]
    assert np.argmin(c2) == np.argmax(np.abs(balancer.lever(q)))
    assert (c2 < AXIAL[1]).all()


def test_the_rail_is_softest_at_its_soft_place():
    plant = Plant(CHAIN, replace(PLAIN, rail=np.array([1e-8] * 3 + [3e-8] * 3), rail_floor=0.1, rail_place=0.7, rail_width=0.5))
    size = []
    for rail in (-1.0, 0.3, 0.7, 1.5):
        conditions = replace(Conditions.idle(1), rail=np.array([rail]))
        start = plant.relaxed(Q, conditions)
        free = plant.equilibrium(Q, conditions, start)[1].p_tcp
        size.append(np.linalg.norm(plant.equilibrium(Q, replace(conditions, force=FORCE), start)[1].p_tcp - free))
    assert size[0] < size[1] < size[2] > size[3]


@pytest.mark.parametrize("link", [0, 3])
def test_a_hose_pulls_both_its_ends_towards_each_other(link):
    hose = Hose(np.array([0.1, 0.0, 0.1]), np.array([0.5, 1.0, 2.5]) if link == 0 else np.array([0.3, 0.2, 0.1]), link,
                80.0, 1.5, 0.7, np.array([0.3, -0.2]))  # fmt: skip
    plant = Plant(CHAIN, replace(PLAIN, hose=hose))
    on = replace(Conditions.idle(1), process_on=np.ones(1, dtype=bool))
    rng = np.random.default_rng(0)
    e = rng.normal(0, 1e-3, (1, plant.dof))
    frames = plant.frames(Q, e)
    torque = plant.load_torque(frames, on, Q)[0]

    def ends(x):
        f = plant.frames(Q, x[None])
        return np.linalg.norm(f.p_attach[0] - np.broadcast_to(f.p_anchor, (1, 3))[0])

    length = ends(e[0])
    tension = 80.0 * np.exp(np.clip((length - 1.5) / 0.7, -2, 2)) * (1 + np.sin(Q[0, [3, 5]]) @ hose.wrist)
    for d in range(plant.dof):
        h = np.zeros(plant.dof)
        h[d] = 1e-6
        assert torque[d] == pytest.approx(-tension * (ends(e[0] + h) - ends(e[0] - h)) / 2e-6, abs=1e-3)
    assert not plant.load_torque(frames, Conditions.idle(1), Q).any()


def _term(place, softens, variables=("joint_3",), product=False, **more):
    count = len(variables)
    size = (0.3 if softens else 1e-4) * np.array([1.0, 0.3])
    where = place, more.get("joint", 2), more.get("index", 1)
    return Term(*where, softens, variables, size, np.ones((2, count)), np.array([0.4, 1.0]), product)


@pytest.mark.parametrize(
    "term",
    [
        _term("axial", True), _term("across", True, ("joint_4", "joint_3")), _term("tool", False, ("force_x", "joint_5"), True),
        _term("base", False, ("force_y",)), _term("axial", False, ("tau_4",)),
    ],
)  # fmt: skip
def test_a_term_moves_the_arm_under_load_and_stops_with_its_size(term):
    loaded = replace(Conditions.idle(1), force=FORCE, known={f"force_{a}": FORCE[:, i] for i, a in enumerate("xyz")})
    free = replace(loaded, force=np.zeros((1, 3)), known={})

    def moved(size):
        plant = Plant(CHAIN, replace(PLAIN, terms=(replace(term, size=size * term.size),)))
        start = plant.relaxed(Q, free)
        return plant.equilibrium(Q, loaded, start)[1].p_tcp - plant.equilibrium(Q, free, start)[1].p_tcp

    plain = moved(0.0)
    assert 1e-6 < np.linalg.norm(moved(1.0) - plain) < 1e-3
    assert np.allclose(moved(2e-3) - plain, 2e-3 / 1e-3 * (moved(1e-3) - plain), rtol=1e-2, atol=1e-11)


def test_springs_too_soft_to_carry_the_arm_are_reported():
    plant = Plant(CHAIN, replace(PLAIN, axial=np.full(6, 1e-3)))
    with pytest.raises(SimError, match="no static equilibrium"):
        plant.relaxed(Q)


@pytest.mark.parametrize(("release", "turned"), [(5e-3, 5e-3), (5e-3, 0.0), (np.inf, 5e-3)])
def test_a_loaded_arm_that_moves_loses_friction_step_by_step_as_in_one_step(release, turned):
    """The cell of the nodes goes in steps of a millisecond, a session that is generated directly from row to row."""
    par = replace(PLAIN, friction=np.full(6, 0.3), friction_torque=np.full(6, 200.0), friction_form="sliders", release=release)
    plant, cell = Plant(CHAIN, par), read_cell("afp")

    def loaded(force):
        return replace(Conditions.idle(1), force=force[None], process_on=np.ones(1, dtype=bool))

    arm = Equilibrium(cell, plant, Q, loaded(np.zeros(3)))
    in_tool = arm.frames.R_tool[0].T @ FORCE[0]
    for _ in range(5):  # standing, so that dry friction holds what it can
        arm.step(Q, False, in_tool, np.zeros(3), loaded, 0.004)
    stood = plant.relaxed(Q, loaded(np.zeros(3)))
    stood, frames = plant.equilibrium(Q, loaded(arm.force), stood)
    np.testing.assert_allclose(arm.frames.p_tcp, frames.p_tcp, atol=1e-6)
    way = Q + turned * np.linspace(0.0, 1.0, 201)[1:, None, None]
    for q in way:
        arm.step(q, True, in_tool, np.zeros(3), loaded, 0.004)
    here, there = way[-1], loaded(arm.force)
    begin = plant.released(frames, Q, loaded(FORCE[0]), stood, here - Q) if np.isfinite(release) else stood
    expected = plant.equilibrium(here, there, begin)[1].p_tcp
    freed = plant.equilibrium(here, there, plant.released(frames, Q, loaded(FORCE[0]), stood))[1].p_tcp
    held = plant.equilibrium(here, there, stood)[1].p_tcp
    size = np.linalg.norm(freed - held)
    assert size > 5e-5
    assert np.linalg.norm(arm.frames.p_tcp - expected) < 0.1 * size
    assert (np.linalg.norm(arm.frames.p_tcp - held) > 0.5 * size) == (turned > 0.0 and np.isfinite(release))
