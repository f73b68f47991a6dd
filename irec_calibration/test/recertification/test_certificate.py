# SPDX-License-Identifier: Apache-2.0
"""The certificate is one page, in two forms, and says what the outcome says."""

from __future__ import annotations

import argparse
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from irec_calibration.commands import history
from irec_calibration.errors import IrecError
from irec_calibration.identification.validation import ESTIMATOR
from irec_calibration.model.file import load_model
from irec_calibration.recertification.flow import Outcome, recertify
from irec_calibration.recertification.quick_check import odds_text
from irec_calibration.recertification.request import Request
from irec_calibration.recertification.store import Store
from irec_calibration.recertification.trend import trend
from irec_calibration.report.certificate import draw_trend, write_certificate
from irec_calibration.report.recertification import _grouped, certificate_of
from irec_calibration.report.style import pyplot
from recertification_cell import FakeCell, place, pose_file

plt = pyplot()


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Store]:
    folder = tmp_path_factory.mktemp("store")
    store = Store(folder, "S-1")
    request = Request("M. <Muster>", str(pose_file(folder / "poses.yaml", 14)))
    recertify(place(), store, request, FakeCell())
    return recertify(place(), store, Request(request.operator, request.poses_path, full=True), FakeCell(seed=50)), store


def test_html_and_pdf_say_verdict_operator_and_error(done: tuple[Outcome, Store], tmp_path: Path) -> None:
    outcome, store = done
    page, pdf = write_certificate(certificate_of(outcome, place(), store, "M. <Muster>"), tmp_path)
    text = page.read_text()
    assert "PASS" in text and f"{1e3 * outcome.judgement.rms_new:.3f} mm" in text  # type: ignore[union-attr]
    assert "M. &lt;Muster&gt;" in text and "<Muster>" not in text
    assert "WO2016151360" in text and "no safety-rated function" in text
    assert "http" not in text, "nothing is loaded from anywhere"
    width, height = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf.read_bytes())[0]
    assert (float(width), float(height)) == pytest.approx((595.3, 841.9), abs=0.5), "A4 in points, with its margins"
    assert pdf.read_bytes().startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b", pdf.read_bytes())) == 1


def test_a_recertified_model_states_its_held_out_error_as_every_other_model_does(done: tuple[Outcome, Store]) -> None:
    outcome, store = done
    figures = load_model(store.model_path(outcome.calibration)).figures
    assert 0.0 < figures["cv_rms_m"] < 3 * figures["fit_rms_m"] and figures["estimator"] == ESTIMATOR


def test_the_certificate_of_a_passed_check_says_what_would_have_been_found(done: tuple[Outcome, Store]) -> None:
    request = Request("M", str(done[1].folder.parent / "poses.yaml"), check_only=True)
    outcome = recertify(place(), done[1], request, FakeCell(seed=70))
    assert outcome.verdict == "pass", outcome.text
    rows = dict(certificate_of(outcome, place(), done[1], "M").rows)
    assert "10 % softer" in rows["Would have been found"] and "5 %" in rows["Would have been found"]
    assert "axis 1, 2" in rows["Would have been found"], "axes of one size stand together"
    assert "play" in rows["Can't be seen at these poses"]
    assert len(rows["Would have been found"].splitlines()) > 2, "one line for each kind of change"


def test_a_passed_check_stands_in_the_trend_as_what_it_confirms_and_not_as_a_calibration(
    done: tuple[Outcome, Store], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(done[1].folder.parent, tmp_path / "c")
    store = Store(tmp_path / "c", "S-1")
    before = trend(store)
    outcome = recertify(place(), store, Request("M", str(tmp_path / "c" / "poses.yaml"), check_only=True), FakeCell(seed=70))
    assert outcome.verdict == "pass" and outcome.quick_plan is not None, outcome.text
    *others, check = trend(store)
    assert [p.at for p in others] == [p.at for p in before]
    of = next(p for p in others if p.calibration == check.calibration)
    assert check.event == "checked" and check.at >= of.at and not check.in_force and of.event == "added"
    assert check.compliance == of.compliance, "nothing is identified anew"
    assert check.softer_below == {
        k: pytest.approx(0.1 * outcome.quick_plan.sizes[f"axis {k + 1}: 10 % softer"]) for k in of.compliance
    }
    certificate = certificate_of(outcome, place(), store, "M")
    value = 1e6 * of.compliance[0].value
    assert f"axis 1: {value:.2f}, less than 10 % more;" in dict(certificate.rows)["How far single axes give way"]
    assert certificate.points[-1].event == "checked"
    page, _ = write_certificate(certificate, tmp_path)
    assert "passed checks" in page.read_text()
    out = _history(store, tmp_path, capsys)
    assert re.search(r"0001 +\S+  confirmed by a check: axis 1 less than 10 % softer", out)


def _history(store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What `irec history` prints of the store's cell."""
    cell = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
    text = cell.read_text().replace("../robots", str(cell.parents[1] / "robots")).replace("KR120-0001", "S-1")
    (tmp_path / "cell.yaml").write_text(text)
    parser = argparse.ArgumentParser()
    history.configure(parser)
    arguments = [str(tmp_path / "cell.yaml"), "--folder", str(store.folder.parent), "-o", str(tmp_path / "trend.png")]
    assert history.run(parser.parse_args(arguments)) == 0
    return capsys.readouterr().out


def test_the_history_of_a_cell_lists_every_event(
    done: tuple[Outcome, Store], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = _history(done[1], tmp_path, capsys)
    assert out.count("added") == 2 and "put in force" in out
    assert re.search(r"^0001 .* mm .*  in force$", out, re.MULTILINE)
    assert (tmp_path / "trend.png").read_bytes().startswith(b"\x89PNG")


def test_a_history_of_nothing_is_refused_in_one_line() -> None:
    with pytest.raises(IrecError, match="name a cell file or a model"):
        history.run(argparse.Namespace(what="/nowhere", folder="x", output=None, json=False))


def test_changes_that_differ_by_size_and_direction_only_stand_in_one_line() -> None:
    said = ["axis 1: 10 % softer", "axis 4: 10 % softer", "base: gives way 10 um/kN more along x"]
    said += ["base: gives way 9 um/kN more along z", "base: tilts 0.03 mrad/(kN m) more about x"]
    assert _grouped([*said, "base: tilts 0.03 mrad/(kN m) more about y"]) == [
        "axis 1, 4: 10 % softer", "base: gives way 10, 9 um/kN more along x, z", "base: tilts 0.03 mrad/(kN m) more about x, y",
    ]  # fmt: skip


def test_a_calibration_that_somebody_has_to_look_at_stands_beside_the_lines_of_the_trend(done: tuple[Outcome, Store]) -> None:
    outcome, store = done
    sound = trend(store)[0]
    axes = plt.subplots(1, 2)[1]
    draw_trend(axes, [sound, replace(sound, verdict="investigate: base_compliance"), sound])
    lines = [line for ax in axes for line in ax.lines if line.get_linestyle() == "-" and len(line.get_xdata()) > 1]
    crosses = [line for line in axes[0].lines if line.get_marker() == "X" and len(line.get_xdata())]
    plt.close()
    assert lines and all(len(line.get_xdata()) == 2 for line in lines)
    assert [list(line.get_xdata()) for line in crosses] == [[1]]
    title = certificate_of(replace(outcome, verdict="investigate: joint_backlash, axis 3"), place(), store, "M").verdict
    assert title == "INVESTIGATE: joint backlash, axis 3"


@pytest.mark.parametrize(("of_change", "words"), [
    (120.4, "120 to 1"), (7.25, "7.2 to 1"), (1.0, "1 to 1"), (1 / 3000, "1 to 3000"), (0.0, "1 to more than 10000"),
    (1e9, "more than 10000 to 1"),
])  # fmt: skip
def test_odds_are_whole_numbers_on_one_side(of_change: float, words: str) -> None:
    assert odds_text(of_change) == words
