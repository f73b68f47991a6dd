# SPDX-License-Identifier: Apache-2.0
"""What a simulated session holds, row by row."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import yaml
from irec_sim.cellfile import read_cell
from irec_sim.kinematics import forward
from irec_sim.session import Conduct, generate, write_session
from irec_sim.truth import make_truth

AFP = read_cell("afp")


def _rows(folder):
    with open(folder / "samples.csv", encoding="utf-8") as f:
        return list(csv.DictReader(f))


def _table(folder, *columns):
    return np.array([[float(row[c]) for c in columns] for row in _rows(folder)])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim") / "s"
    made = generate(AFP, make_truth("afp", [], 1), 6, seed=3, repeats=2)
    write_session(made, folder, "demo")
    return made, folder


def test_a_session_has_every_pose_load_case_and_repeat_once(written):
    _, folder = written
    keys = [(r["pose"], r["load_case"], r["repeat"]) for r in _rows(folder)]
    assert len(keys) == len(set(keys)) == 6 * 6 * 2
    header = yaml.safe_load((folder / "session.yaml").read_text())
    assert header["format"] == "irec-session/1" and header["kind"] == "loaded"
    assert (folder / header["robot"]["urdf"]).read_text() == AFP.chain.text


def test_stamps_rise(written):
    stamps = _table(written[1], "stamp")[:, 0]
    assert (np.diff(stamps) > 0).all()


def test_the_controllers_tcp_is_the_kinematics_of_its_angles(written):
    _, folder = written
    q = _table(folder, *(f"joint_{k}" for k in range(1, 7)))
    assert np.abs(forward(AFP.chain, q).p_tcp - _table(folder, "tcp_x", "tcp_y", "tcp_z")).max() < 1e-8


def test_joint_angles_are_within_their_limits(written):
    q = _table(written[1], *(f"joint_{k}" for k in range(1, 7)))
    assert (q > AFP.chain.lower).all() and (q < AFP.chain.upper).all()


def test_pressing_reads_a_negative_force_and_the_reference_reads_none(written):
    _, folder = written
    case, force = _table(folder, "load_case")[:, 0], _table(folder, "force_x", "force_y", "force_z")
    assert np.abs(force[case == 0]).max() < 6.0
    assert (force[case > 0, 2] < -1050.0).all()
    assert (force[case == 2, 0] > 250.0).all() and (force[case == 4, 1] < -250.0).all()


def test_the_arm_gives_way_in_the_direction_of_the_force(written):
    made, _ = written
    rows = made.rows[0]
    R = np.stack([forward(AFP.chain, rows.q[:, j]).R_tool for j in range(1, 6)], 1)
    force = np.einsum("nmij,nmj->nmi", R, rows.wrench_force[:, 1:])
    assert (np.einsum("nmi,nmi->nm", force, rows.deflection) > 0).all()


def test_the_marker_shows_the_deflection_but_for_the_turn_of_the_tool(written):
    made, _ = written
    difference = made.rows[0].apparent_deflection(AFP) - made.rows[0].deflection
    assert 0 < np.abs(difference).max() < 1e-4


def test_load_cases_in_random_order_have_an_order_of_their_own_in_each_pose(tmp_path):
    made = generate(AFP, make_truth("afp", [], 1), 8, seed=3, conduct=Conduct(random_order=True))
    write_session(made, tmp_path / "s", "s")
    orders = [tuple(int(r["load_case"]) for r in _rows(tmp_path / "s") if int(r["pose"]) == i) for i in range(1, 9)]
    assert all(order[0] == 0 and sorted(order) == list(range(6)) for order in orders) and len(set(orders)) > 4
    case, force = _table(tmp_path / "s", "load_case")[:, 0], _table(tmp_path / "s", "force_x", "force_y", "force_z")
    assert (force[case == 2, 0] > 250.0).all() and (force[case == 4, 1] < -250.0).all()


def test_repeats_of_some_poses_count_up_from_zero(tmp_path):
    made = generate(AFP, make_truth("afp", [], 1), 6, seed=3, conduct=Conduct(repeats=3, repeated_poses=2))
    write_session(made, tmp_path / "s", "s")
    keys = [(r["pose"], r["load_case"], int(r["repeat"])) for r in _rows(tmp_path / "s")]
    assert len(keys) == len(set(keys)) == 6 * 6 + 2 * 2 * 6
    assert len({k[0] for k in keys if k[2] == 1}) == 2 and {k[0] for k in keys if k[2] == 1} == {k[0] for k in keys if k[2] == 2}


def test_the_same_seed_gives_the_same_session_and_another_seed_another(tmp_path):
    texts = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_session(generate(AFP, make_truth("afp", ["creep"], 1), 3, seed=seed), tmp_path / name, "x")
        texts.append((tmp_path / name / "samples.csv").read_text())
    assert texts[0] == texts[1] != texts[2]
