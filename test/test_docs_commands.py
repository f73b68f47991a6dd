# SPDX-License-Identifier: Apache-2.0
"""Every irec command of the docs runs, from a folder in which there is what it names."""

from __future__ import annotations

import shutil
from importlib import import_module
from pathlib import Path

import pytest
from irec_calibration.cli import main
from irec_calibration.effects import registry
from irec_calibration.session import read_session
from irec_calibration.session.mcap_io import write_mcap
from test_docs import DOCS, PAGES, ROOT, commands_of, irec_words
from workbench_server import write_hidden

OWN_EFFECT = "docs/adding-an-effect.md"
ELSEWHERE = {
    "join": "test_follow_up.py and irec_calibration/test/session",
    "plan": "test_afp_planning_and_codec.py and irec_calibration/test/poses",
    "codec": "test_afp_planning_and_codec.py and irec_calibration/test/codec",
    "tool-load": "irec_calibration/test/sensors",
    "latency": "irec_calibration/test/sensors",
    "posture": "test_posture.py",
    "profile": "test_profile_command.py",
    "filter": "test_filter_command.py",
    "links": "test_links_command.py",
    "course-filter": "test_course_filter_command.py",
    "workbench": "irec_calibration/test/workbench/test_browser.py",
    "init-cell": "test_own_cell.py",
    "show-cell": "test_own_cell.py",
    "check": "irec_calibration/test/commands/test_check.py",
}
pytestmark = pytest.mark.slow


def commands() -> list[str]:
    """All irec commands of the docs that are not run elsewhere, each once, in the order of the pages."""
    pages = [*PAGES, *sorted(ROOT.glob("irec_*/README.md"))]
    lines = [line.split("  #")[0].strip() for page in pages for line in commands_of(page)]
    return [x for x in dict.fromkeys(lines) if (w := irec_words(x)) and len(w) > 1 and w[1] not in ELSEWHERE]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory):
    """What the pages name: SESSION, both (sessions that were joined), RECORDING, model.yaml, model2.yaml, improved/model.yaml,
    table, my_effects.py, config, mine/mine.yaml."""
    place = tmp_path_factory.mktemp("docs")
    write_hidden(place / "SESSION")
    shutil.copytree(place / "SESSION", place / "both")
    session = read_session(place / "SESSION")
    write_mcap(session, place / "RECORDING.mcap")
    shutil.copytree(ROOT / "config", place / "config")
    shutil.copytree(ROOT / "config" / "robots", place / "robots")
    shutil.copytree(ROOT / "config" / "cells", place / "mine")
    (place / "mine" / "afp.yaml").rename(place / "mine" / "mine.yaml")
    blocks = (ROOT / OWN_EFFECT).read_text(encoding="utf-8").split("```python\n")[1:]
    (place / "my_effects.py").write_text(next(b for b in blocks if "cubic_hardening" in b).split("```")[0], encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert main(["solve", "SESSION", "-o", "model.yaml"]) == 0
        assert main(["add", "model.yaml", "axis 1: c * tau**3", "SESSION", "-o", "model2.yaml", "--quick"]) == 0
        assert main(["export", "RECORDING.mcap", "-o", "table"]) == 0
    (place / "improved").mkdir()
    shutil.copy(place / "model.yaml", place / "improved" / "model.yaml")
    return place


@pytest.fixture(scope="module", autouse=True)
def _one_analysis_for_all():
    """The commands run as they are; the diagnosis behind them is computed once for each model and session."""
    running, improving = (import_module(f"irec_calibration.diagnose.{name}") for name in ("run", "improve"))
    original, kept = running.examine, {}

    def examine(session, model=None, *, progress=None, cancelled=None):
        key = model.effects if model else (), len(session), session.contact is None  # without its tracker it is another session
        if key not in kept:
            kept[key] = original(session, model)
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_registered", {})  # other tests read files that define the effect of the page too
        patch.setattr(registry, "_files", {})
        patch.setattr(running, "examine", examine)
        patch.setattr(improving, "examine", examine)
        yield


@pytest.mark.parametrize("line", commands())
def test_a_command_of_the_docs_runs(line, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    words = irec_words(line)
    assert words is not None
    words = ["RECORDING.mcap" if w in ("RECORDING", "BAG") else "joint_stiffening" if w == "EFFECT" else w for w in words[1:]]
    if words[0] in ("add", "solve", "import", "export") and "-o" in words:
        at = words.index("-o") + 1
        words[at] = f"made/{len(list(folder.rglob('*')))}/{Path(words[at]).name}"  # what other commands read stays as it is
        (folder / words[at]).parent.mkdir(parents=True, exist_ok=True)
    if words[0] == "add":
        words.append("--quick")
    code = main(words)
    said = capsys.readouterr()
    assert code in ((0, 1) if words[0] in ("diagnose", "inspect") else (0,)), f"{line}: {said.out}{said.err}"
    assert said.out


def test_pages_name_only_commands_that_are_run_here_or_elsewhere():
    assert len(commands()) > 25 and (DOCS / "tutorial.md").is_file()
    for place in {p.split(" and ")[0] for p in ELSEWHERE.values()}:
        assert (ROOT / place).exists() or (ROOT / "test" / place).exists(), place
