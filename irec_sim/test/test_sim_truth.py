# SPDX-License-Identifier: Apache-2.0
"""Truth files, folders and matrices of simulated sessions: what is written where, and what is refused."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from irec_sim.absolute import MISHAPS as ABSOLUTE_MISHAPS
from irec_sim.cellfile import read_cell
from irec_sim.cli import main
from irec_sim.errors import SimError
from irec_sim.hidden import write_matrix
from irec_sim.matrix import Case, matrix_cases
from irec_sim.mishaps import KINDS
from irec_sim.truth import EFFECTS, read_truth

AFP = read_cell("afp")
TRUTHS = Path(__file__).parents[2] / "config" / "truths"


def _rows(folder):
    with open(folder / "samples.csv", encoding="utf-8") as f:
        return list(csv.DictReader(f))


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
