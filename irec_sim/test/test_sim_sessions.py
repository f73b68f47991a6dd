# SPDX-License-Identifier: Apache-2.0
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from irec_sim.absolute import MISHAPS as ABSOLUTE_MISHAPS
from irec_sim.cellfile import read_cell
from irec_sim.cli import main
from irec_sim.errors import SimError
from irec_sim.hidden import draw_absolute_session, draw_session, write_matrix
from irec_sim.kinematics import forward
from irec_sim.matrix import Case, clean_cases, matrix_cases
from irec_sim.mishaps import KINDS
from irec_sim.noise import TrueNoise, claimed_over_true, draw_claim, marker_noise
from irec_sim.observe import simulate
from irec_sim.oracle import consult
from irec_sim.outside import GRAMMAR, OUTSIDE
from irec_sim.plant import Plant
from irec_sim.poses import spread_poses
from irec_sim.replay import Replay
from irec_sim.sensing import force_reading, true_force
from irec_sim.session import Conduct, effect_share, generate, make_schedule, scale_to_share, write_session
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


def test_noise_of_the_marker_is_the_linear_sum_that_the_header_states():
    made = generate(AFP, make_truth("afp", [], 1), 40, seed=0)
    error = made.passes[0].marker - made.rows[0].p_marker
    noise = AFP.noise
    sigma = np.hypot(noise["tracker_m"] + noise["tracker_m_per_m"] * made.rows[0].distance, noise["settling_m"])
    assert (error / sigma[..., None]).std() == pytest.approx(1.0, abs=0.08)
    force = made.passes[0].force - made.rows[0].force_reading
    assert force.std() == pytest.approx(noise["force_n"], rel=0.1)


QUIET = TrueNoise(10e-6, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("tail", ["normal", "student", "contaminated"])
@pytest.mark.parametrize("slow_share", [0.0, 0.7])
def test_tails_and_slow_wandering_leave_the_standard_deviation_as_it_is(tail, slow_share):
    noise = replace(QUIET, tail=tail, dof=6.0, slow_share=slow_share)
    n = 20000
    error = marker_noise(noise, 30.0 * np.arange(n), np.zeros(n, int), np.full(n, 4.0), np.random.default_rng(0))
    assert error.std() == pytest.approx(10e-6, rel=0.05)


def test_heavy_tails_are_heavier_than_normal():
    n = 20000
    size = {}
    for tail in ("normal", "student", "contaminated"):
        noise = replace(QUIET, tail=tail)
        error = marker_noise(noise, np.arange(n) * 1.0, np.zeros(n, int), np.full(n, 4.0), np.random.default_rng(0))
        size[tail] = (np.abs(error) > 40e-6).mean()
    assert size["student"] > 10 * size["normal"] and size["contaminated"] > 10 * size["normal"]


def test_slow_noise_is_alike_within_seconds_and_forgotten_after_minutes_and_apart_per_station():
    noise = replace(QUIET, slow_share=1.0, slow_time=60.0)
    n = 20000
    station = np.arange(n) % 2
    error = marker_noise(noise, np.repeat(np.arange(n // 2) * 6.0, 2), station, np.full(n, 4.0), np.random.default_rng(0))
    a, b = error[::2, 0], error[1::2, 0]
    assert np.corrcoef(a[:-1], a[1:])[0, 1] == pytest.approx(np.exp(-0.1), abs=0.05)
    assert abs(np.corrcoef(a[:-60], a[60:])[0, 1]) < 0.1 and abs(np.corrcoef(a, b)[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("way", "low", "high"), [("factor", 0.5, 2.0), ("settling_left_out", 0.3, 0.99), ("root_sum", 0.6, 0.99)]
)
def test_a_wrong_claim_is_wrong_within_a_factor_of_two(way, low, high):
    noise = TrueNoise(10e-6, 3e-6, 3e-6, 1.0)
    for seed in range(10):
        factor = claimed_over_true(draw_claim(noise, way, np.random.default_rng(seed)), noise, np.array([3.0, 5.0]))
        assert low - 1e-3 <= factor <= high + 1e-3 and abs(np.log(factor)) > 0.02
    assert claimed_over_true(draw_claim(noise, "right", np.random.default_rng(0)), noise, np.array([4.0])) == pytest.approx(1.0)


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


@pytest.mark.parametrize("kind", KINDS)
def test_a_mishap_spoils_the_rows_that_the_truth_says_and_no_others(kind):
    truth = make_truth("afp", [], 1)
    plain = generate(AFP, truth, 6, seed=3, conduct=Conduct(random_order=True))
    spoiled = generate(AFP, truth, 6, seed=3, conduct=Conduct(random_order=True, mishap=kind))
    (mishap,) = spoiled.mishaps
    a, b = plain.passes[0], spoiled.passes[0]
    moved = [(x != y).reshape(6, 6, -1).any(axis=2) for x, y in ((a.marker, b.marker), (a.q, b.q), (a.force, b.force))]
    changed = np.any(moved, axis=0)
    if kind == "reseated_reflector":  # stays where it is put: later poses see it at their reference too
        changed[np.arange(6) > np.flatnonzero(a.pose == mishap.pose)[0]] = False
    i = int(np.flatnonzero(a.pose == mishap.pose)[0])
    assert list(np.flatnonzero(changed.any(axis=1))) == [i]
    if kind == "bumped_reference":
        assert list(np.flatnonzero(changed[i])) == [0] and set(mishap.load_cases) == set(range(1, 6))
    else:
        assert {int(c) for c in a.case[i][changed[i]]} == set(mishap.load_cases)


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
    for seed in range(8):  # some draws don't show: play on an axis whose torque never changes sign, torque of an idle axis
        truth, shown = scale_to_share(AFP, make_truth("afp", [effect], 5 + seed), 0.08, poses=8)
        if shown:
            break
    assert shown == {effect}
    rng = np.random.default_rng([0, 2])
    schedule = make_schedule(AFP, spread_poses(AFP, 8, rng), 0.0, rng)
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
    assert len(GRAMMAR) >= 10 and len(set(EFFECTS) - names) >= 20


@pytest.mark.parametrize("name", sorted(OUTSIDE))
def test_a_cause_without_a_name_says_which_columns_show_it(name):
    columns = {"load_case", "stamp", "ext_rail", *(f"force_{a}" for a in "xyz"), "temp_ambient"}
    columns |= {f"{v}_{k}" for v in ("joint", "tau", "temp_gear") for k in range(1, 7)}
    for seed in range(5):
        said = OUTSIDE[name].variables(OUTSIDE[name].draw(np.random.default_rng(seed)))
        assert said and set(said) <= columns


def test_the_same_kind_of_sentence_says_something_else_each_time():
    kinds = [OUTSIDE["stiffness_of_two_angles"].draw(np.random.default_rng(seed)) for seed in range(8)]
    assert len({(p["place"], p["joint"], *p["variables"]) for p in kinds}) > 4
    assert len({p["phase"][0] for p in kinds}) == 8


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


def test_a_station_that_was_bumped_stays_there_in_later_passes():
    made = generate(MILLING, make_truth("milling", ["station_shift"], 1), 6, 3, repeats=3)
    parted = [(rows.shifted != rows.shifted[:, :1]).any(axis=1).sum() for rows in made.rows]
    assert parted == [1, 0, 0]
    assert all(rows.shifted.all() for rows in made.rows[1:])


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
        ("a: [", "not YAML"),
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
    cases = [Case("clean"), Case("single", ("tool_compliance",), 0.08), Case("outside", ("taper",), 0.15, mishap="jump")]
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
        told = yaml.safe_load((truth / row["name"] / "truth.yaml").read_text())
        assert {"effects", "noise", "claim", "mishaps", "oracle"} <= set(told)
        assert read_truth(truth / row["name"] / "truth.yaml", row["cell"]).as_data()["effects"] == told["effects"]
    assert truth.parent == tmp_path and not list((tmp_path / "m").rglob("truth*"))


def test_half_of_the_sessions_of_each_kind_state_their_noise_wrongly_and_a_third_have_a_mishap():
    cases = matrix_cases(np.random.default_rng(0))
    for kind in {c.kind for c in cases}:
        some = [c for c in cases if c.kind == kind]
        assert sum(c.claim != "right" for c in some) == pytest.approx(len(some) / 2, abs=1)
        share = 1.0 if kind == "robust" else 1 / 3
        assert sum(bool(c.mishap) for c in some) == pytest.approx(share * len(some), abs=1)
    assert sum(c.kind == "many" for c in cases) / len(cases) == pytest.approx(0.25, abs=0.02)
    assert {c.mishap for c in cases} == {"", *KINDS, *ABSOLUTE_MISHAPS}


def test_a_quick_matrix_has_about_forty_sessions_and_the_size_scales_it():
    quick = matrix_cases(np.random.default_rng(0), quick=True)
    assert 35 <= len(quick) <= 50
    full, half = (len(matrix_cases(np.random.default_rng(0), size=s)) for s in (1.0, 0.5))
    assert half == pytest.approx(full / 2, abs=4)
    assert {c.kind for c in matrix_cases(np.random.default_rng(0), only=["many", "clean"])} == {"many", "clean"}


CELLS = {"afp": AFP, "milling": MILLING}


def test_the_oracle_sees_a_strong_effect_and_gains_by_knowing_it():
    drawn = draw_session(Case("single", ("joint_coupling",), 0.15), 3, 20, 12, CELLS)
    (seen,) = drawn.oracle.seen
    assert seen.visible and seen.nats > 50.0
    assert drawn.oracle.oracle_m < 0.5 * drawn.oracle.base_m


@pytest.mark.parametrize("effect", ["encoder_harmonics", "joint_backlash"])
def test_the_oracle_does_not_see_what_does_not_show(effect):
    truth = make_truth("milling", [effect], 5)
    truth = truth.scaled(effect, 1e-3)
    made, check = (generate(MILLING, truth, n, seed=n) for n in (15, 10))
    assert not consult(made, check, truth).seen[0].visible


def test_a_mishap_does_not_blind_the_oracle():
    case = Case("single", ("sensor_alignment",), 0.1, mishap="jump")
    spoiled, plain = (draw_session(c, 3, 20, 12, CELLS) for c in (case, replace(case, mishap="")))
    assert spoiled.oracle.oracle_m == pytest.approx(plain.oracle.oracle_m, rel=0.3)


def test_the_oracles_replay_of_the_truth_is_what_the_plant_did():
    effects = ["tool_compliance", "joint_hysteresis", "creep", "sensor_gain", "rail_compliance", "external_force", "sensor_lag"]
    truth = make_truth("afp", effects, 5, off_centre=0.05)
    made = generate(AFP, truth, 6, seed=2, conduct=Conduct(random_order=True))
    _, tcp = Replay(made, 0, truth.physics(), made.rows[0].force_reading)(truth.physics())
    assert np.abs(tcp - made.rows[0].deflection).max() < 2e-7


def test_a_replay_with_springs_at_other_places_is_what_such_a_plant_does():
    truth = make_truth("afp", [], 5, off_centre=0.03)
    other = replace(truth, centre=truth.centre + 0.01)
    made, moved = (generate(AFP, t, 6, seed=2) for t in (truth, other))
    replay = Replay(made, 0, truth.physics(), made.rows[0].force_reading)
    change = replay(other.physics())[1] - replay(truth.physics())[1]
    truly = moved.rows[0].deflection - made.rows[0].deflection
    assert np.abs(truly).max() > 2e-6
    assert np.abs(change - truly).max() < 0.05 * np.abs(truly).max()


def test_the_oracle_has_to_find_where_springs_sit():
    at_origins = make_truth("milling", [], 5)
    anywhere = replace(at_origins, centre=at_origins.centre + 1e-9)  # the same plant, but nobody says so
    known, sought = (
        consult(generate(MILLING, t, 15, seed=1), generate(MILLING, t, 10, seed=2), t).oracle_m for t in (at_origins, anywhere)
    )
    assert sought > 1.02 * known


def test_the_true_force_is_read_back_from_the_reading():
    physics = make_truth("afp", ["sensor_gain", "sensor_alignment", "tool_weight"], 5).physics()
    rng = np.random.default_rng(0)
    force, R = rng.normal(0, 500, (4, 3)), forward(AFP.chain, rng.uniform(-1, 1, (4, 6))).R_tool
    read = force_reading(physics.sensing, AFP.sensor_axis, force, R)
    assert np.abs(read - force).max() > 5.0
    assert np.allclose(true_force(physics.sensing, AFP.sensor_axis, read, R), force, atol=1e-9)


@pytest.mark.parametrize("effect", ["geometry_error", "encoder_harmonics", "joint_settling"])
def test_what_wrong_joint_angles_and_lengths_make_of_the_commanded_displacement_is_no_part_of_the_true_deflection(effect):
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, spread_poses(AFP, 4, rng), 0.0, rng)
    wrong = make_truth("afp", [effect], 1).scaled(effect, 3.0)
    rows = simulate(AFP, wrong.physics(), replace(schedule, force=np.zeros_like(schedule.force)))
    assert np.abs(rows.apparent_deflection(AFP)).max() > 2e-6
    assert np.abs(rows.deflection).max() < 1e-12


def test_what_passes_with_time_is_no_part_of_the_true_deflection():
    rng = np.random.default_rng(0)
    schedule = make_schedule(AFP, spread_poses(AFP, 4, rng), 0.0, rng)
    plain, drifting = (simulate(AFP, make_truth("afp", e, 1).physics(), schedule) for e in ([], ["thermal_drift"]))
    assert np.abs(plain.deflection - drifting.deflection).max() < 1e-9
    assert np.abs(plain.apparent_deflection(AFP) - drifting.apparent_deflection(AFP)).max() > 1e-6


def test_clean_sessions_hide_nothing_whatever_the_noise():
    cases = clean_cases(np.random.default_rng(0), 12)
    assert [c.kind for c in cases] == 12 * ["clean"] + 12 * ["absolute"]
    assert {c.slow for c in cases} == {False, True}
    assert {c.claim == "right" for c in cases} == {False, True}
    assert not any(draw_absolute_session(c, i, 20, 3).made.truth.hidden for i, c in enumerate(cases[12:16]))
