# SPDX-License-Identifier: Apache-2.0
"""A recertification from preconditions to what is in force, on a synthetic robot that ages."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import marker_by_controller
from irec_calibration.errors import IrecError
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, Term, blank_model
from irec_calibration.model.file import save_model
from irec_calibration.poses.store import read_poses
from irec_calibration.recertification.flow import Outcome, recertify
from irec_calibration.recertification.judgement import Missing, judge
from irec_calibration.recertification.preconditions import Precondition, another_tool, told_lines
from irec_calibration.recertification.quick_plan import MOST_LATERAL
from irec_calibration.recertification.request import Place, Request, Tool
from irec_calibration.recertification.run_state import interrupted
from irec_calibration.recertification.store import Store
from irec_calibration.report.recertification import certificate_of
from irec_calibration.robot import Payload
from irec_calibration.session import Session, read_session, write_table
from recertification_cell import FakeCell, place, pose_file
from scipy.spatial.transform import Rotation

PLACE = place()
MARKER = np.array([0.02, 0.0, -0.03])  # of synthetic sessions, in tool0


def softer(axis: int, factor: float) -> np.ndarray:
    return synthetic.COMPLIANCE * np.where(np.arange(6) == axis - 1, factor, 1.0)


@pytest.fixture(scope="module")
def commissioned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a store with one calibration in force; copied by the tests that change it."""
    folder = tmp_path_factory.mktemp("commissioned")
    poses = pose_file(folder / "poses.yaml")
    outcome = recertify(PLACE, Store(folder, "S-1"), Request("M. Muster", str(poses)), FakeCell())
    assert outcome.verdict == "recalibrated" and outcome.activated, outcome.text
    return folder


@pytest.fixture
def store(commissioned: Path, tmp_path: Path) -> Store:
    shutil.copytree(commissioned, tmp_path / "c")
    return Store(tmp_path / "c", "S-1")


def year(store: Store, side: FakeCell, where: Place = PLACE, **request: object) -> Outcome:
    poses = str(store.folder.parent / "poses.yaml")
    return recertify(where, store, Request("M. Muster", poses, **request), side)  # type: ignore[arg-type]


def test_a_robot_that_has_not_changed_passes_by_the_quick_check_alone(store: Store) -> None:
    side = FakeCell(seed=100)
    outcome = year(store, side)
    assert outcome.verdict == "pass", outcome.text
    assert side.runs == ["quick"] and not side.activated
    assert store.in_force_entry().calibration == "0001"  # type: ignore[union-attr]
    assert store.entries()[-1].event == "checked"


def test_an_axis_that_has_become_softer_is_found_and_recalibrated(store: Store) -> None:
    side = FakeCell(seed=200, compliance=softer(2, 1.2))
    outcome = year(store, side)
    assert outcome.verdict == "recalibrated" and outcome.activated, outcome.text
    assert side.runs == ["quick", "full"]
    assert "axis 2" in outcome.text
    entry, path, model = store.in_force()  # type: ignore[misc]
    assert entry.calibration == "0002" and side.activated == [path]
    torsion = next(t for t in model.terms if t.effect.id == "joint_torsion")
    assert torsion.estimates["c_2"].value == pytest.approx(1.2 * synthetic.COMPLIANCE[1], rel=0.15)


def test_a_loosened_base_is_to_be_looked_at_and_not_calibrated_away(store: Store) -> None:
    def loose(scene):  # type: ignore[no-untyped-def]
        moment = np.cross(scene.p_tcp, scene.force)
        turn = moment * np.array([4e-8, 4e-8, 0.0])
        return np.cross(turn, scene.p_observed)

    hint = Missing("missing_effect", ("base_compliance",), {}, 1e-4, "Added, the error falls.")
    outcome = year(store, FakeCell(seed=300, extra=loose, missing=hint))
    assert outcome.verdict.startswith("investigate: base_compliance"), outcome.text
    assert not outcome.activated and "Do this now" in outcome.text
    assert store.in_force_entry().calibration == "0001"  # type: ignore[union-attr]
    assert outcome.calibration == "0002", "it is stored, for whoever decides to use it all the same"
    assert outcome.text.rpartition("Do this now: ")[2].startswith("check the bolts of the base"), "ends in what to do now"


def test_the_full_procedure_starts_from_the_effects_of_the_model_in_force_and_not_from_18_dof(tmp_path: Path) -> None:
    """An engineer has added an effect to the model; the year after, axis 2 is softer."""

    def loose(scene):  # type: ignore[no-untyped-def]
        turn = np.cross(scene.p_tcp, scene.force) * np.array([1.5e-7, 1.5e-7, 0.0])
        return np.cross(turn, scene.p_observed)

    poses = pose_file(tmp_path / "poses.yaml")
    session = FakeCell(seed=50, extra=loose).measured(poses)
    improved = (*blank_model(EIGHTEEN_DOF), Term(find_effect("base_compliance")))
    (tmp_path / "improved").mkdir()
    save_model(model_of(identify(session, improved)), tmp_path / "improved" / "model.yaml")
    write_table(session, tmp_path / "improved" / "session")
    shutil.copyfile(poses, tmp_path / "improved" / "poses.yaml")
    store = Store(tmp_path / "cal", "S-1")
    store.put_in_force(store.add(tmp_path / "improved", "recalibrated", "M. Muster").calibration, "M. Muster")

    request = Request("M. Muster", str(poses), full=True)
    outcome = recertify(PLACE, store, request, FakeCell(seed=500, extra=loose, compliance=softer(2, 1.2)))
    assert outcome.verdict == "recalibrated" and "axis 2" in outcome.text, outcome.text
    assert outcome.judgement is not None and outcome.judgement.rms_new < 1.3 * outcome.judgement.noise_floor
    _, _, model = store.in_force()  # type: ignore[misc]
    assert {t.effect.id for t in model.terms} == {t.effect.id for t in improved}
    plain = judge(read_session(outcome.session_path), None, None, PLACE.acceptance, PLACE.tolerance)
    assert plain.rms_new > 2.0 * outcome.judgement.rms_new, "18 DOF alone do not describe this robot"


def test_an_effect_that_the_diagnosis_names_is_to_be_looked_at(store: Store) -> None:
    named = Missing("missing_effect", ("joint_backlash",), {"joint_backlash": ("axis 3",)}, 5e-5, "Gear play in axis 3.")
    outcome = year(store, FakeCell(seed=400, compliance=softer(2, 1.2), missing=named))
    assert outcome.verdict == "investigate: joint_backlash, axis 3", outcome.text
    assert not outcome.activated


def test_the_diagnosis_and_the_store_see_the_tracker_where_it_was_found(store: Store) -> None:
    seen: list[float] = []

    class Moved(FakeCell):
        """Its tracker stands centimetres and milliradians from where the cell file says."""

        def measured(self, poses_path: Path) -> Session:
            s = super().measured(poses_path)
            R = Rotation.from_rotvec([4e-3, -3e-3, 5e-3]).as_matrix()
            return replace(s, p_marker_in_station=s.p_marker_in_station @ R.T + [0.02, -0.01, 0.03])

        def diagnose(self, session_path: Path, model_path: Path, folder: Path) -> Missing:
            seen.append(elsewhere(read_session(session_path)))
            return Missing("adequate")

    def elsewhere(s: Session) -> float:
        in_base = s.p_marker_in_station @ s.stations[0].R_in_base.T + np.array(s.stations[0].xyz)
        return float(np.abs(in_base - marker_by_controller(s, s.robot.kinematics(s.q))).max())

    side = Moved(seed=200, compliance=softer(2, 1.2))
    outcome = year(store, side, full=True)
    assert outcome.verdict == "recalibrated", outcome.text
    kept = read_session(store.session_path("0002"))  # type: ignore[arg-type]
    assert elsewhere(read_session(outcome.session_path)) > 0.02, "the recording is as it was measured"
    assert seen == [elsewhere(kept)] and seen[0] < 3e-3


def test_nothing_moves_where_a_precondition_does_not_hold(store: Store) -> None:
    side = FakeCell(problems=(Precondition("tracker", False, "does not see the marker; free the line of sight"),))
    outcome = year(store, side)
    assert outcome.verdict == "failed: tracker" and "free the line of sight" in outcome.text
    assert side.runs == []


@pytest.mark.parametrize("operator", ["", "   "])
def test_without_the_name_of_an_operator_nothing_moves(store: Store, operator: str) -> None:
    side = FakeCell()
    outcome = recertify(PLACE, store, Request(operator, str(store.folder.parent / "poses.yaml")), side)
    assert outcome.verdict == "failed: operator" and side.runs == []


@pytest.mark.parametrize("operator", ["12", "-", "M. Mustre"])
def test_only_a_name_of_the_cell_file_may_answer_for_it_where_it_lists_some(store: Store, operator: str) -> None:
    side, where = FakeCell(), replace(PLACE, operators=("M. Muster", "B. Beispiel"))
    poses = str(store.folder.parent / "poses.yaml")
    outcome = recertify(where, store, Request(operator, poses), side)
    assert outcome.verdict == "failed: operator" and f"'{operator}'" in outcome.text and side.runs == []
    if operator[0] == "M":
        assert "M. Muster, B. Beispiel" in outcome.text
    assert "operator:" not in recertify(where, store, Request(" m.  muster ", "nowhere.yaml"), side).text


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        (Tool("", Payload(40.0), MARKER), "mass is 40.0 kg, then 0.0 kg"),
        (Tool("", Payload(0.0), MARKER + [0.0, 0.03, 0.04]), "marker lies 50.0 mm elsewhere"),
    ],
)
def test_another_tool_in_the_cell_file_is_refused_before_anything_moves(store: Store, tool: Tool, words: str) -> None:
    side = FakeCell()
    outcome = year(store, side, where=replace(PLACE, tool=tool))
    assert outcome.verdict == "failed: stated tool" and words in outcome.text and "mount that tool again" in outcome.text
    assert side.runs == []


def test_a_tool_is_told_by_its_name_and_small_differences_are_none() -> None:
    before = synthetic.session(3)
    called = replace(before, meta={**before.meta, "tool": "head A"})
    assert "called 'head B', then 'head A'" in another_tool(Tool("head B", Payload(0.0), MARKER), called)
    for same in (Tool("head A", Payload(0.0), MARKER), Tool("", Payload(0.3), MARKER + 2e-3)):
        assert another_tool(same, called) == ""


def test_a_folder_that_can_not_be_written_is_told_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    side = FakeCell()
    poses = str(pose_file(tmp_path / "poses.yaml", 14))
    outcome = recertify(PLACE, Store(tmp_path / "file" / "c", "S-1"), Request("M. Muster", poses), side)
    assert outcome.verdict == "failed: disk" and "can't be written" in outcome.text and side.runs == []


def test_on_a_full_disk_nothing_moves(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type("Usage", (), {"free": 1e8})
    monkeypatch.setattr("irec_calibration.recertification.preconditions.shutil.disk_usage", lambda _: usage)
    side = FakeCell()
    outcome = year(store, side)
    assert outcome.verdict == "failed: disk" and "0.1 GB free; 2 GB are needed" in outcome.text
    assert side.runs == []


@pytest.mark.parametrize("serial", ["S-2"])
def test_poses_and_models_of_another_robot_are_refused_before_anything_moves(store: Store, serial: str) -> None:
    side = FakeCell()
    outcome = recertify(replace(PLACE, serial=serial), store, Request("M. Muster", str(store.folder.parent / "poses.yaml")), side)
    assert outcome.verdict == "failed: model" and "poses" in outcome.text
    assert side.runs == []


def test_every_refusal_ends_in_what_to_do_now(store: Store) -> None:
    wrong = [Precondition(name, False, "is not as it has to be; mend it") for name in ("tracker", "force sensor", "temperature")]
    outcome = recertify(PLACE, store, Request("", "nowhere.yaml"), FakeCell(problems=tuple(wrong)))
    assert outcome.verdict == "failed: operator"
    for name in ("operator", "poses", "tracker", "force sensor", "temperature"):
        assert f"{name}: " in outcome.text
    assert outcome.text.endswith("then start again.") and "Do this now: put that right" in outcome.text


def test_a_model_that_somebody_has_edited_is_refused_before_anything_moves(store: Store) -> None:
    path = store.model_path("0001")
    path.write_text(path.read_text() + "\n# a little better\n")
    side = FakeCell()
    outcome = year(store, side)
    assert outcome.verdict == "failed: model" and "changed since" in outcome.text
    assert side.runs == []


def test_a_run_that_was_interrupted_goes_on_in_the_same_recording(store: Store) -> None:
    side = FakeCell(seed=500, compliance=softer(2, 1.2), stop_after=9)
    with pytest.raises(IrecError, match="resume"):
        year(store, side, full=True)
    assert "procedure" in interrupted(store)
    outcome = year(store, side, resume=True)
    assert side.runs == ["full", "full resumed"]
    assert outcome.verdict == "recalibrated", outcome.text
    assert interrupted(store) == ""


def test_a_run_that_went_on_still_tells_what_its_quick_check_had_found(store: Store) -> None:
    side = FakeCell(seed=500, compliance=softer(2, 1.2))
    measure = side.run

    def run(poses_path, session_path, resume, enough):  # type: ignore[no-untyped-def]
        if session_path.stem == "full" and not resume:
            write_table(side.measured(poses_path).select_poses([1, 2, 3]), session_path)
            return "no force readings for 3 s"
        return measure(poses_path, session_path, resume, enough)

    side.run = run  # type: ignore[method-assign]
    with pytest.raises(IrecError, match="resume"):
        year(store, side)
    outcome = year(store, side, resume=True)
    assert side.runs == ["quick", "full resumed"] and outcome.verdict == "recalibrated", outcome.text
    assert outcome.quick is not None and outcome.quick.decision == "changed" and outcome.quick_plan is not None


def test_the_quick_check_presses_harder_across_the_tool_where_the_cell_bears_it(store: Store) -> None:
    side = FakeCell(seed=100, lateral=2.0)
    outcome = year(store, side)
    assert outcome.verdict == "pass", outcome.text
    listed = read_poses(outcome.folder / "quick_poses.yaml")  # type: ignore[operator]
    assert listed.lateral_factor == MOST_LATERAL == outcome.quick_plan.lateral  # type: ignore[union-attr]
    across = np.abs(read_session(outcome.session_path).force_in_tool[:, :2]).max()
    assert across > 1.15 * np.abs(read_session(store.session_path("0001")).force_in_tool[:, :2]).max()  # type: ignore[arg-type]
    rows = dict(certificate_of(outcome, PLACE, store, "M").rows)
    assert "poses, with 1.3 times the forces across the tool; odds" in rows["Quick check"]


def test_a_quick_check_goes_on_with_the_forces_that_it_was_begun_with(store: Store) -> None:
    side = FakeCell(seed=500, stop_after=2, lateral=1.2)
    with pytest.raises(IrecError, match="resume"):
        year(store, side)
    side.lateral = 1.0
    outcome = year(store, side, resume=True)
    assert side.runs[:2] == ["quick", "quick resumed"], outcome.text
    assert outcome.quick_plan.lateral == 1.2  # type: ignore[union-attr]


def test_a_run_goes_on_with_the_poses_that_it_began_with(store: Store) -> None:
    poses = store.folder.parent / "poses.yaml"
    side = FakeCell(seed=500, stop_after=9)
    with pytest.raises(IrecError, match="resume"):
        year(store, side, full=True)
    poses.write_text("format: irec-poses/1\n")
    outcome = year(store, side, resume=True)
    assert side.runs == ["full", "full resumed"] and outcome.verdict == "pass", outcome.text


def test_a_quick_check_does_not_go_on_after_another_calibration_was_put_in_force(store: Store) -> None:
    side = FakeCell(seed=500, stop_after=2)
    with pytest.raises(IrecError, match="resume"):
        year(store, side)
    files = store.folder / "0001"
    store.put_in_force(store.add(files, "recalibrated", "M").calibration, "M")
    with pytest.raises(IrecError, match="calibration 0002 is in force now, 0001 was.*Do this now: start without resume"):
        year(store, side, resume=True)
    assert side.runs == ["quick"]


def test_a_state_that_was_edited_is_refused_by_its_key(store: Store) -> None:
    with pytest.raises(IrecError):
        year(store, FakeCell(seed=500, stop_after=2))
    path = max((store.folder / "runs").glob("*/run.json"))  # the newest; the first one is of the commissioning
    path.write_text(path.read_text().replace('"quick_check"', '"done_nearly"'))
    outcome = year(store, FakeCell(), resume=True)
    assert outcome.verdict == "failed: poses" and "stage is" in outcome.text and "Do this now: remove" in outcome.text


def test_going_on_needs_a_run_that_was_interrupted(store: Store) -> None:
    with pytest.raises(IrecError, match="no interrupted run"):
        year(store, FakeCell(), resume=True)


def test_a_finished_calibration_that_the_correction_refuses_is_kept_and_can_be_put_in_force_later(store: Store) -> None:
    side = FakeCell(seed=600, compliance=softer(2, 1.2), refuses="correction_node does not answer")
    outcome = year(store, side)
    assert outcome.verdict == "recalibrated" and not outcome.activated
    assert "nothing has to be measured again" in outcome.text
    assert store.in_force_entry().calibration == "0001"  # type: ignore[union-attr]
    store.put_in_force(outcome.calibration, "M. Muster")
    assert store.in_force_entry().calibration == "0002"  # type: ignore[union-attr]


def test_a_dry_run_tells_its_answer_and_puts_nothing_in_force(store: Store) -> None:
    side = FakeCell(seed=700, compliance=softer(2, 1.2))
    outcome = year(store, side, dry_run=True)
    assert outcome.verdict == "recalibrated" and "dry run" in outcome.text and not side.activated


def test_a_check_only_never_starts_the_full_procedure(store: Store) -> None:
    side = FakeCell(seed=800, compliance=softer(2, 1.2))
    outcome = year(store, side, check_only=True)
    assert outcome.verdict == "failed: the robot has changed" and side.runs == ["quick"]


def test_a_check_only_moves_nothing_where_there_is_nothing_to_compare_with(tmp_path: Path) -> None:
    side, poses = FakeCell(), pose_file(tmp_path / "poses.yaml", 10)
    outcome = recertify(PLACE, Store(tmp_path, "S-1"), Request("M. Muster", str(poses), check_only=True), side)
    assert outcome.verdict == "failed: model" and "recalibrate" in outcome.text
    assert side.runs == [] and not side.activated


def test_a_check_only_that_is_to_be_full_as_well_is_refused_before_anything_moves(store: Store) -> None:
    side = FakeCell()
    outcome = year(store, side, check_only=True, full=True)
    assert outcome.verdict == "failed: model" and "leave one of them out" in outcome.text and side.runs == []


def test_too_few_poses_come_with_the_error_first_and_with_what_to_do(tmp_path: Path) -> None:
    poses = pose_file(tmp_path / "poses.yaml", 10)
    outcome = recertify(PLACE, Store(tmp_path, "S-1"), Request("M. Muster", str(poses)), FakeCell())
    assert outcome.verdict == "failed: 10 poses were measured, at least 12 are needed"
    assert outcome.text.startswith("On poses kept apart the new calibration errs by ")
    assert "Do this now: measure the rest of the poses" in outcome.text


def test_the_state_of_a_run_is_on_the_disk_while_it_measures(store: Store) -> None:
    side = FakeCell(seed=900)
    seen: list[str] = []
    measure = side.run

    def run(poses_path, session_path, resume, enough):  # type: ignore[no-untyped-def]
        seen.append(json.loads((session_path.parent / "run.json").read_text())["stage"])
        return measure(poses_path, session_path, resume, enough)

    side.run = run  # type: ignore[method-assign]
    year(store, side, full=True)
    assert seen == ["procedure"]


def test_each_precondition_is_told_before_anything_moves(store: Store) -> None:
    side = FakeCell(problems=(Precondition("tracker", False, "does not see the marker; free the line of sight"),))
    outcome = year(store, side)
    assert outcome.verdict == "failed: tracker" and not side.runs
    lines = [line for message in side.reported for line in told_lines(message.removeprefix("preconditions: "))]
    assert lines[0] == "✓ operator: M. Muster"
    assert lines[-1] == "✗ tracker: does not see the marker; free the line of sight"
    assert {line[2:].partition(":")[0] for line in lines} == {"operator", "model", "poses", "disk", "tracker"}


def test_a_cell_without_a_tracker_is_refused_before_anything_is_looked_at(tmp_path: Path) -> None:
    side = FakeCell(problems=(Precondition("tracker", False, "does not see the marker"),))
    poses = pose_file(tmp_path / "poses.yaml")
    outcome = recertify(replace(PLACE, without_tracker=True), Store(tmp_path, "S-1"), Request("M. Muster", str(poses)), side)
    assert outcome.verdict == "failed: tracker" and not side.runs and not side.activated
    assert "procedure.without_tracker: true" in outcome.text and "does not see" not in outcome.text
