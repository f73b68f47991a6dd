# SPDX-License-Identifier: Apache-2.0
import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from irec_sim.cellfile import read_cell
from irec_sim.cli import main
from irec_sim.errors import SimError
from irec_sim.hidden import Case, write_matrix
from irec_sim.kinematics import forward
from irec_sim.observe import simulate
from irec_sim.plant import Plant
from irec_sim.poses import spread_poses
from irec_sim.session import effect_share, generate, make_schedule, scale_to_share, write_session
from irec_sim.truth import EFFECTS, make_truth, read_truth
from irec_sim.truth_catalogue import CATALOGUE

AFP, MILLING = read_cell("afp"), read_cell("milling")
TRUTHS = Path(__file__).parents[2] / "config" / "truths"


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


def test_noise_of_the_marker_is_what_the_header_states():
    made = generate(AFP, make_truth("afp", [], 1), 40, seed=0)
    error = made.markers[0] - made.rows[0].p_marker
    noise = AFP.noise
    sigma = np.sqrt(noise["tracker_m"] ** 2 + (noise["tracker_m_per_m"] * made.rows[0].distance) ** 2 + noise["settling_m"] ** 2)
    assert (error / sigma[..., None]).std() == pytest.approx(1.0, abs=0.08)
    force = made.forces[0] - made.rows[0].force_reading
    assert force.std() == pytest.approx(noise["force_n"], rel=0.1)


def test_the_same_seed_gives_the_same_session_and_another_seed_another(tmp_path):
    texts = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_session(generate(AFP, make_truth("afp", ["creep"], 1), 3, seed=seed), tmp_path / name, "x")
        texts.append((tmp_path / name / "samples.csv").read_text())
    assert texts[0] == texts[1] != texts[2]


def test_the_stiffness_of_the_truth_is_what_the_deflection_shows():
    truth = make_truth("afp", [], 1, friction=0.0)
    made = generate(AFP, truth, 4, seed=1)
    rows = made.rows[0]
    plant = Plant(AFP.chain, truth.physics().plant)
    R = forward(AFP.chain, rows.q[:, 1]).R_tool
    expected = plant.deflection(rows.q[:, 1], (R @ rows.wrench_force[:, 1, :, None])[..., 0])
    assert np.abs(rows.deflection[:, 0] - expected).max() < 5e-6


@pytest.mark.parametrize("effect", sorted(set(EFFECTS) - {"encoder_harmonics"}))
def test_every_effect_reaches_the_share_asked_for(effect):
    for seed in range(4):  # play on an axis whose torque never changes sign doesn't show
        truth, shown = scale_to_share(AFP, make_truth("afp", [effect], 5 + seed), 0.08, poses=10)
        if shown:
            break
    assert shown == {effect}
    rng = np.random.default_rng([0, 2])
    schedule = make_schedule(AFP, spread_poses(AFP, 10, rng), 0.0, rng)
    before = simulate(AFP, truth.without(effect).physics(), schedule)
    assert effect_share(AFP, truth, effect, schedule, before) == pytest.approx(0.08, rel=0.03)


def test_encoder_harmonics_move_the_marker_but_cancel_under_load():
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, spread_poses(AFP, 5, rng), 0.0, rng)
    plain, truth = (make_truth("afp", e, 1) for e in ([], ["encoder_harmonics"]))
    a, b = (simulate(AFP, t.physics(), schedule) for t in (plain, truth))
    assert np.abs(a.p_marker - b.p_marker).max() > 2e-5
    assert np.abs(a.apparent_deflection(AFP) - b.apparent_deflection(AFP)).max() < 2e-6


def test_the_catalogue_of_the_contract_is_complete():
    names = {
        "tool_compliance", "base_compliance", "rail_compliance", "joint_stiffening", "joint_backlash", "joint_hysteresis",
        "counterbalance", "joint_coupling", "sensor_gain", "sensor_alignment", "tool_weight", "station_registration",
        "tracker_scale", "station_shift", "thermal_drift", "creep", "marker_offset", "geometry_error", "joint_settling",
        "encoder_harmonics", "external_force",
    }  # fmt: skip
    assert set(CATALOGUE) == names
    assert len(set(EFFECTS) - names) >= 4


def test_what_only_the_instruments_see_does_not_deflect_the_tcp():
    rng = np.random.default_rng(0)
    schedule = make_schedule(MILLING, spread_poses(MILLING, 5, rng), 0.0, rng)
    plain = simulate(MILLING, make_truth("milling", [], 1).physics(), schedule)
    for effect in (
        "station_registration",
        "tracker_scale",
        "station_shift",
        "sensor_gain",
        "sensor_alignment",
        "tool_weight",
        "marker_offset",
    ):
        rows = simulate(MILLING, make_truth("milling", [effect], 1).physics(), schedule)
        assert np.abs(rows.deflection - plain.deflection).max() < 1e-9, effect


@pytest.mark.parametrize("path", sorted(TRUTHS.glob("*.yaml")), ids=lambda p: p.stem)
def test_truth_files_of_the_repository_can_be_read_and_written_again(path, tmp_path):
    truth = read_truth(path, "afp", 3)
    again = tmp_path / "t.yaml"
    again.write_text(yaml.safe_dump(truth.as_data()))
    other = read_truth(again, "afp", 99)
    assert other.as_data() == truth.as_data()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format: irec-truth/2", "format must be"),
        ("format: irec-truth/1\neffects: [{effect: gremlins}]", "'gremlins' is not known"),
        ("format: irec-truth/1\neffects: [{effect: creep, parameters: {speed: 1}}]", "no parameter speed"),
        ("format: irec-truth/1\ncompliance: {axial: [1.0e-7]}", "axial needs 6 positive values"),
        ("a: [", "can't be read"),
    ],
)
def test_a_wrong_truth_file_is_refused_with_file_and_reason(text, message, tmp_path):
    path = tmp_path / "t.yaml"
    path.write_text(text)
    with pytest.raises(SimError, match=message) as caught:
        read_truth(path, "afp")
    assert str(path) in str(caught.value)


def test_a_session_folder_says_nothing_about_its_truth(tmp_path):
    where = ["-o", str(tmp_path / "s"), "--truth-out", str(tmp_path / "t")]
    assert main(["session", "--effect", "joint_backlash", "--strength", "0.1", "--poses", "4", *where]) == 0
    text = "".join(p.read_text() for p in (tmp_path / "s").iterdir())
    for word in (*EFFECTS, "truth", "seed", "strength", "scale:"):
        assert word not in text
    truth = yaml.safe_load((tmp_path / "t" / "truth.yaml").read_text())
    assert truth["effects"][0]["effect"] == "joint_backlash"
    with open(tmp_path / "t" / "truth.csv", encoding="utf-8") as f:
        assert len(list(csv.DictReader(f))) == 4 * 5


def test_the_truth_may_not_be_written_into_the_session(tmp_path, capsys):
    code = main(["session", "--poses", "2", "-o", str(tmp_path / "s"), "--truth-out", str(tmp_path / "s" / "t")])
    assert code == 2
    assert "must not be inside" in capsys.readouterr().err


def test_a_strength_that_is_no_share_is_refused(tmp_path, capsys):
    assert main(["session", "--effect", "creep", "--strength", "8", "-o", str(tmp_path / "s")]) == 2
    assert "share of the RMS deflection" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


def test_an_existing_folder_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "mine.txt").write_text("x")
    assert main(["session", "--poses", "2", "-o", str(tmp_path / "s")]) == 2
    assert "not empty" in capsys.readouterr().err


def test_a_blind_matrix_keeps_names_opaque_and_the_truth_apart(tmp_path):
    cases = [Case("clean", (), 0.0), Case("single", ("tool_compliance",), 0.08), Case("outside", ("taper",), 0.15)]
    truth = write_matrix(tmp_path / "m", 4, cases, poses=4, validation_poses=3)
    with open(truth / "matrix.csv", encoding="utf-8") as f:
        rows = list(csv.DictReader(f))
    assert sorted(r["effects"] for r in rows) == ["", "taper", "tool_compliance"]
    for row in rows:
        for part in ("sessions", "validation"):
            header = yaml.safe_load((tmp_path / "m" / part / row["name"] / "session.yaml").read_text())
            assert header["name"] == row["name"]
        assert len(_rows(tmp_path / "m" / "sessions" / row["name"])) == 4 * 6
        with open(truth / row["name"] / "truth.csv", encoding="utf-8") as f:
            assert len(list(csv.DictReader(f))) == 3 * 5
    assert truth.parent == tmp_path and not list((tmp_path / "m").rglob("truth*"))
