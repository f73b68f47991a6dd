# SPDX-License-Identifier: Apache-2.0
"""The terminal: where to begin, examples, judgement of what was added, the next step, nothing overwritten, nothing too wide."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys

import pytest
from irec_calibration.cli import COMMANDS, main
from irec_calibration.commands._progress import Progress
from irec_calibration.commands.guidance import EXAMPLES
from irec_calibration.model.file import load_model
from workbench_server import write_hidden


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A session with a hidden effect and the 18-DOF model of it."""
    folder = tmp_path_factory.mktemp("measured")
    session = write_hidden(folder / "session")
    assert main(["solve", str(session), "-o", str(folder / "model.yaml")]) == 0
    return str(session), str(folder / "model.yaml")


def test_irec_alone_says_where_to_begin(capsys):
    assert main([]) == 0
    said = capsys.readouterr().out
    assert "irec diagnose SESSION" in said and "irec plan CELL" in said


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_s_help_has_an_example_and_what_comes_out(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit):
        main([command, "--help"])
    said = capsys.readouterr().out
    assert "example:\n  " in said and "what comes out:" in said


def test_every_command_has_an_example():
    assert set(COMMANDS) == set(EXAMPLES)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c not in ("completion", "workbench")])
def test_every_command_has_json(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    assert "--json" in capsys.readouterr().out


def test_adding_what_is_there_is_supported_and_says_what_to_do_next(measured, tmp_path, capsys):
    session, model = measured
    out = str(tmp_path / "m.yaml")
    assert main(["add", model, "axis 1: c * tau**3", session, "-o", out, "--quick"]) == 0
    said = capsys.readouterr().out
    assert "The data support it" in said and f"irec diagnose {session} --model {out}" in said
    assert "formula_axis_1.c" in said and "+-" in said
    assert load_model(out).effects[-1] == "formula_axis_1"


def test_adding_what_is_not_there_is_not_supported(measured, tmp_path, capsys):
    session, model = measured
    assert main(["add", model, "tool x: c * sin(30 * q_4)", session, "-o", str(tmp_path / "m.yaml"), "--quick"]) == 0
    said = capsys.readouterr().out
    assert "do not support" in said and "irec diagnose" in said


def test_rivals_are_named(measured, tmp_path, capsys):
    session, model = measured
    assert main(["add", model, "axis 1: c * tau**3", session, "-o", str(tmp_path / "m.yaml"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["support"] == "supported" and isinstance(said["rivals"], list) and "sensor_gain" not in said["rivals"]


def test_a_model_file_is_not_overwritten_unless_told_so(measured, tmp_path, capsys):
    session, model = measured
    out = tmp_path / "m.yaml"
    out.write_text("format: irec-model/1\n")
    assert main(["remove", model, "link_bending", session, "-o", str(out)]) == 2
    assert "--force" in capsys.readouterr().err and out.read_text() == "format: irec-model/1\n"
    assert main(["remove", model, "link_bending", session, "-o", str(out), "--force"]) == 0
    assert load_model(out).effects == ("joint_torsion",)


def test_a_typing_error_in_a_formula_is_no_parameter(measured, tmp_path, capsys, monkeypatch):
    session, model = measured
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    assert main(["add", model, "axis 1: c * taw**3", session, "-o", str(tmp_path / "m.yaml")]) == 2
    said = capsys.readouterr().err
    assert "did you mean tau?" in said and "--parameter taw" in said and not (tmp_path / "m.yaml").exists()


def test_a_declared_name_is_a_parameter(measured, tmp_path):
    session, model = measured
    out = str(tmp_path / "m.yaml")
    assert main(["add", model, "axis 1: slope * tau**3", session, "--parameter", "slope", "-o", out, "--quick"]) == 0
    assert "slope" in load_model(out).terms[-1].estimates


def test_parameters_are_for_formulas(measured, capsys):
    session, model = measured
    assert main(["add", model, "creep", session, "--parameter", "c"]) == 2
    assert "id of an effect" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.long
def test_a_diagnosis_fits_a_hundred_columns_and_prints_the_command_that_adds_what_it_named(measured, tmp_path):
    session, model = measured
    command = [sys.executable, "-m", "irec_calibration.cli", "diagnose", session, "--model", model, "-o", str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=280)
    lines = done.stdout.splitlines()
    assert done.returncode == 1, done.stderr
    assert any(line.strip().startswith(f"irec add {model} joint_stiffening {session}") for line in lines)
    assert [line for line in lines if len(line) > 100 and session not in line and str(tmp_path) not in line] == []


def test_other_commands_name_the_next_step(measured, capsys):
    session, model = measured
    assert main(["compare", model, session]) == 0
    assert f"irec diagnose {session} --model {model}" in capsys.readouterr().out


def test_nothing_but_json_is_printed_where_json_is_asked_for(measured, capsys):
    session, model = measured
    assert main(["compare", model, session, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rms_m"] > 0.0


def test_the_time_left_is_given_as_a_range_and_not_before_it_can_be_known():
    assert "left" not in Progress.line(0.1, "work", 3.0)
    assert Progress.line(0.5, "work", 10.0) == " 50 %  work, 10 s, 5 to 20 s left"
    assert Progress.line(1.0, "done", 12.0) == "100 %  done in 12 s"


def test_a_shell_completes_commands_and_options(tmp_path):
    pytest.importorskip("argcomplete")
    for line, expected in (("irec dia", "diagnose"), ("irec diagnose --mo", "--model")):
        out = tmp_path / "out"
        environment = os.environ | {
            "_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_STDOUT_FILENAME": str(out),
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "_ARGCOMPLETE_IFS": "\n",
        }  # fmt: skip
        subprocess.run(
            [sys.executable, "-m", "irec_calibration.cli"], env=environment, check=False, capture_output=True, timeout=120
        )
        assert expected in out.read_text()
