# SPDX-License-Identifier: Apache-2.0
"""The docs: every command in them can be parsed, the tutorial's run in their order, the site builds strictly."""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from irec_calibration.cli import COMMANDS, command_module, main
from workbench_server import write_hidden

from irec_sim import cli as simulator

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


def commands_of(page: Path) -> list[str]:
    """Lines of the shell blocks of a page, continued lines joined, without comments."""
    blocks = re.findall(r"^[ ]*```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    lines = [line.strip() for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [line for line in lines if line and not line.startswith("#")]


def irec_words(line: str) -> list[str] | None:
    """Words of an irec command, or None."""
    words = shlex.split(line, comments=True)
    if words and words[0].endswith(".venv/bin/irec"):
        words[0] = "irec"
    return words if words and words[0] == "irec" else None


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))
def test_every_irec_command_of_a_page_has_arguments_that_exist(page):
    for line in commands_of(page):
        words = irec_words(line)
        if words is None or len(words) == 1:
            continue
        assert words[1] in COMMANDS or words[1].startswith("-") or words[1] == "COMMAND", line
        if words[1] in COMMANDS:
            parser = argparse.ArgumentParser(prog=words[1], exit_on_error=False)
            command_module(COMMANDS[words[1]][0]).configure(parser)
            parser.add_argument("--effects", action="append")
            try:
                parser.parse_args(words[2:])
            except (argparse.ArgumentError, SystemExit) as error:
                pytest.fail(f"{page.name}: {line}: {error}")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))
def test_every_make_target_of_a_page_exists(page):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for line in commands_of(page):
        words = shlex.split(line, comments=True)
        if words and words[0] == "make":
            assert [w for w in words[1:] if "=" not in w and w not in targets] == [], f"{page.name}: {line}"


def pages_with(*programs: str) -> list[tuple[str, str]]:
    """Page and line of each command of one of these programs, README and the contract of the driver included."""
    pages = [*PAGES, ROOT / "README.md", ROOT / "irec_sim" / "README.md"]
    found = []
    for page in pages:
        text = page.read_text(encoding="utf-8")
        lines = [*commands_of(page), *re.findall(r"^    (\S.*)$", text, re.MULTILINE)]
        found += [(str(page.relative_to(ROOT)), line) for line in lines if line.split()[0] in programs]
    return found


@pytest.mark.parametrize(("page", "line"), pages_with("irec-sim"))
def test_every_irec_sim_command_has_arguments_that_exist(page, line):
    parser = simulator._parser()
    parser.parse_args(shlex.split(line, comments=True)[1:])  # SystemExit would fail the test


@pytest.mark.parametrize(("page", "line"), pages_with("python", "python3"))
def test_every_tool_that_is_run_with_python_is_there(page, line):
    script = shlex.split(line, comments=True)[1]
    assert (ROOT / script).is_file(), f"{page}: {line}"


@pytest.mark.parametrize(("page", "line"), pages_with("ros2"))
def test_every_ros2_command_names_what_is_there(page, line):
    words = shlex.split(line, comments=True)
    if words[1] == "run":
        assert f'"{words[3]} = ' in (ROOT / words[2] / "setup.py").read_text(), line
        sections = (DOCS / "node-parameters.md").read_text().split("\n## ")
        (section,) = [s for s in sections if s.startswith(words[3] + "\n")]
        more = next(s for s in sections if s.startswith("correction_node\n")) if words[3] == "rsi_bridge" else ""
        for name in (w.partition(":=")[0] for before, w in pairwise(words) if before == "-p"):
            assert f"| `{name}` |" in section + more or name == "use_sim_time", f"{line}: no parameter {name}"
    elif words[1] == "launch":
        launch = (ROOT / words[2] / "launch" / words[3]).read_text()
        for name in (w.partition(":=")[0] for w in words[4:]):
            assert f'DeclareLaunchArgument("{name}"' in launch, f"{line}: no argument {name}"
    elif words[1] in ("action", "service") and words[2] in ("send_goal", "call"):
        _, kind, values = [w for w in words[3:] if not w.startswith("--")]
        package, folder, name = kind.split("/")
        if package == "irec_msgs":
            text = (ROOT / package / folder / f"{name}.{'action' if folder == 'action' else 'srv'}").read_text().split("---")[0]
            fields = {row.split()[1] for row in text.splitlines() if row.strip() and not row.startswith("#")}
            assert set(yaml.safe_load(values)) <= fields, line
    else:
        assert words[1] in ("lifecycle", "security", "topic", "param", "node", "pkg", "bag", "component", "service"), line


def test_the_commands_of_the_tutorial_run_in_their_order(tmp_path, monkeypatch, capsys):
    write_hidden(tmp_path / "SESSION")
    monkeypatch.chdir(tmp_path)
    ran = 0
    for line in commands_of(DOCS / "tutorial.md"):
        words = irec_words(line)
        if words is None or words[1] in ("diagnose", "report"):  # the same analysis as in the tests of these commands
            continue
        quick = ["--quick"] if words[1] == "add" else []
        assert main([*words[1:], *quick]) == 0, f"{line}: {capsys.readouterr().err}"
        ran += 1
    assert ran >= 6 and (tmp_path / "model4.yaml").exists()


def test_messages_that_the_troubleshooting_page_quotes_are_those_of_the_code():
    folders = (ROOT / package / package for package in ("irec_calibration", "irec_correction"))
    code = "".join(p.read_text(encoding="utf-8") for folder in folders for p in folder.rglob("*.py"))
    flat = re.sub(r"\"\s*\n\s*f?\"", "", code)
    rows = re.findall(r"^\| `([^`]+)` \|", (DOCS / "troubleshooting.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(rows) > 10
    for message in rows:
        parts = re.sub(r"'[^']*'|…|\b\d[\d.]*\b", "\0", message).split("\0")
        longest = max((p.strip(" :`") for p in parts), key=len)
        assert longest in flat or message == "`Connection lost` in the page", message


@pytest.mark.slow
def test_the_site_builds_strictly_and_loads_nothing_from_elsewhere(tmp_path):
    pytest.importorskip("material", reason="mkdocs-material is missing: make build")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", str(ROOT / "mkdocs.yml")]
    command += ["-d", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "effects" / "joint_stiffening.html").read_text(encoding="utf-8")
    assert "joint_stiffening.png" in page
    for html in (tmp_path / "site").rglob("*.html"):
        for url in re.findall(r'(?:src|href)="(https?://[^"]+)"', html.read_text(encoding="utf-8")):
            assert not url.endswith((".js", ".css", ".woff2")) and "fonts." not in url, f"{html.name}: {url}"
