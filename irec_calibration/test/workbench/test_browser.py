# SPDX-License-Identifier: Apache-2.0
"""Whole stories in a real browser: headless Chromium plays a person at the workbench. Screenshots stay in the test's folder."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from irec_calibration.model.file import load_model
from workbench_server import CHROMIUM, Server

pytest.importorskip("nicegui", reason="NiceGUI is missing: pip install 'irec_calibration[workbench]'")
pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install playwright")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM, reason="no Chromium here: apt-get install chromium"),
]
LONG = 150_000  # ms: a machine with other work
HIDDEN = "axis 1: c * tau**3"
KEPT = os.environ.get("IREC_SCREENSHOTS")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = Path(KEPT) if KEPT else tmp_path_factory.mktemp("workbench")
    made.mkdir(parents=True, exist_ok=True)
    return made


@pytest.fixture(scope="module")
def server(hidden_session: Path, folder: Path) -> Iterator[Server]:
    made = Server(folder, str(hidden_session))
    yield made
    made.kill()


class Person:
    """A browser tab, and what its person looks for."""

    def __init__(self, browser: object, folder: Path, width: int = 1920, height: int = 1080) -> None:
        self.folder = folder
        self.page = browser.new_page(viewport={"width": width, "height": height})  # type: ignore[attr-defined]
        self.page.set_default_timeout(LONG)
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.page.on("pageerror", lambda e: self.errors.append(str(e)))
        self.page.on("request", lambda r: self.asked.append(r.url))

    def part(self, name: str):
        return self.page.get_by_test_id(name)

    def sees(self, name: str, text: str = "", timeout: int = LONG) -> None:
        found = self.part(name).filter(has_text=text) if text else self.part(name)
        found.first.wait_for(state="visible", timeout=timeout)

    def has_focus(self, name: str) -> None:
        self.page.wait_for_function("(n) => document.activeElement.dataset.testid === n", arg=name, timeout=LONG)

    def uses_version(self, number: int) -> None:
        there = "(n) => document.querySelector(`[data-testid=version-${n}]`)?.getAttribute('aria-current') === 'true'"
        self.page.wait_for_function(there, arg=number, timeout=LONG)

    def keeps_picture(self, name: str) -> None:
        if KEPT:
            self.page.wait_for_timeout(700)  # for a person who looks at it: everything has moved to its place
        self.page.screenshot(path=str(self.folder / f"{name}.png"))


@pytest.fixture
def person(browser, server, folder) -> Iterator[Person]:
    made = Person(browser, folder)
    made.page.goto(server.url)
    made.sees("version-1")
    yield made
    made.page.close()
    assert made.errors == []
    elsewhere = [u for u in made.asked if not u.startswith((server.url, "data:", "blob:", f"ws://127.0.0.1:{server.port}"))]
    assert elsewhere == []


def test_a_person_finds_the_hidden_effect_tries_it_keeps_it_and_saves_the_model(person, server, folder):
    person.keeps_picture("1-opened")
    person.sees("verdict")
    assert "An effect is missing" in person.part("verdict").inner_text()
    person.keeps_picture("2-diagnosed")
    person.part("try-joint_stiffening").click()
    person.sees("trial", "The data support it")
    person.part("keep").click(timeout=LONG)
    person.sees("version-2", "joint_stiffening")
    person.page.keyboard.press("]")
    person.sees("sample", "force in tool0")
    person.keeps_picture("3-kept")
    person.page.get_by_role("button", name="Save …").click()
    person.part("save-model").click()
    person.sees("status", "Model written to")
    (saved,) = (folder / "out").glob("model*.yaml")
    assert load_model(saved).effects == ("joint_torsion", "link_bending", "joint_stiffening")
    person.part("undo").click()
    person.uses_version(1)


def test_a_person_tries_an_own_formula_is_asked_about_a_typing_error_and_throws_it_away(person):
    box = person.page.get_by_label("formula of an effect")
    box.click()
    box.press_sequentially("axis 4: c * si", delay=20)
    person.sees("suggestion", "sin(")
    box.fill("")
    box.press_sequentially("axis 4: c * * tau", delay=20)
    person.sees("formula-message", "no expression")
    person.keeps_picture("4-error-under-the-cursor")
    box.fill("")
    box.press_sequentially("axis 4: c * sin(9 * taw)", delay=20)
    person.part("use-meant").click(timeout=LONG)
    person.part("try-formula").click()
    person.sees("trial", "do not support")
    person.keeps_picture("5-not-supported")
    person.part("discard").click()
    person.part("trial").wait_for(state="detached", timeout=LONG)
    assert person.part("version-2").count() == 0


def test_a_person_works_with_the_keyboard_alone(person):
    person.page.get_by_label("formula of an effect").focus()
    person.page.keyboard.type(HIDDEN, delay=20)
    person.page.keyboard.press("Enter")
    person.sees("trial", "The data support it")
    person.page.wait_for_function("!document.querySelector('[data-testid=keep]').disabled", timeout=LONG)
    person.part("keep").focus()
    person.page.keyboard.press("Enter")
    person.sees("version-2")
    person.has_focus("version-2")  # what had it is gone: not back to the top of the page
    person.part("undo").focus()
    person.page.keyboard.press("Enter")
    person.uses_version(1)
    person.has_focus("redo")  # undo can go no further
    person.page.keyboard.press("Enter")
    person.uses_version(2)
    person.page.keyboard.press("Control+z")
    person.uses_version(1)


def test_undo_and_redo_are_the_same_buttons_all_the_time(person):
    # a key or a click that meets a button while it is replaced is not heard
    person.page.evaluate("for (const n of ['undo', 'redo']) document.querySelector(`[data-testid=${n}]`).dataset.seen = 'before'")
    person.part("switch-link_bending").click()
    person.sees("version-2", "- link_bending")
    person.part("undo").click()
    person.uses_version(1)
    assert [person.part(n).get_attribute("data-seen") for n in ("undo", "redo")] == ["before", "before"]


def test_a_control_keeps_the_focus_while_the_page_is_drawn_anew(person):
    person.sees("verdict")
    person.part("diagnose").focus()
    person.page.keyboard.press("]")
    person.sees("sample")
    person.has_focus("diagnose")
    person.part("version-1").focus()
    person.page.evaluate("window.before = document.activeElement")
    person.part("switch-link_bending").click()  # draws the list of versions anew
    person.part("version-1").focus()
    person.sees("version-2", "- link_bending")
    person.has_focus("version-1")
    assert person.page.evaluate("window.before.isConnected") is False


def test_a_person_takes_a_group_with_the_mouse_and_all_views_answer_for_it(person):
    person.sees("verdict")
    person.page.wait_for_function(
        "(d => d?.data?.length > 2 && d.layout.dragmode === 'select')(document.querySelector('[data-testid=norms]'))",
        timeout=LONG,
    )
    area = person.part("norms").locator(".nsewdrag[data-subplot=xy]").bounding_box()
    y = area["y"] + 0.5 * area["height"]
    person.page.mouse.move(area["x"] + 0.2 * area["width"], y)
    person.page.mouse.down()
    person.page.mouse.move(area["x"] + 0.3 * area["width"], y + 5, steps=4)
    person.page.mouse.move(area["x"] + 0.4 * area["width"], y + 9, steps=4)
    person.page.mouse.up()
    person.sees("group", "samples")
    size = int(person.part("group").inner_text().split(" of 70 samples")[0])
    assert 10 <= size <= 18
    drawn = "(a) => document.querySelector(`[data-testid=${a[0]}]`)?.data?.find(t => t.name === a[1])?.x.length"
    for trace, points in (("samples", size), ("other samples", 70 - size)):
        person.page.wait_for_function(f"(a) => ({drawn})(a) === a[2]", arg=["cell-plot", trace, points], timeout=LONG)
    person.page.wait_for_function(
        "document.querySelector('[data-testid=ladder]')?.layout?.yaxis?.title?.text.startsWith('of the group')", timeout=LONG
    )
    person.part("tab-against").click()
    person.page.wait_for_function(f"(a) => ({drawn})(a) === a[2]", arg=["against-plot", "base x", size], timeout=LONG)
    person.keeps_picture("11-group")
    person.part("all-samples").click()
    person.part("group").wait_for(state="detached", timeout=LONG)
    person.part("tab-samples").click()


def test_a_recording_that_is_still_being_written_is_followed(browser, server, folder, growing):
    person = Person(browser, folder, 1280, 900)
    path, states = growing
    path.write_bytes(states[8])
    person.page.goto(f"{server.url}/open")
    person.page.get_by_label("path on this machine").fill(str(path))
    person.part("look").click()
    person.sees("checklist", "8 poses")
    person.part("open").click(timeout=LONG)
    person.sees("subtitle", "8 poses")
    person.part("follow").click()
    path.write_bytes(states[10])
    person.sees("subtitle", "10 poses")
    path.write_bytes(states[11])
    person.sees("subtitle", "11 poses")
    person.sees("verdict")
    person.part("tab-growth").click()
    grown = "document.querySelector('[data-testid=growth]')?.data?.some(t => t.x?.length >= 7)"
    person.page.wait_for_function(grown, timeout=LONG)
    person.keeps_picture("12-followed")
    person.page.close()
    assert person.errors == []


@pytest.mark.parametrize(("name", "width", "height"), [("1280", 1280, 800), ("tablet", 820, 1180)])
def test_nothing_is_wider_than_the_screen(browser, server, folder, name, width, height):
    person = Person(browser, folder, width, height)
    person.page.goto(server.url)
    person.sees("version-1")
    person.sees("verdict")  # everything is there that can be wide
    person.keeps_picture(f"6-{name}")
    assert person.page.evaluate("document.documentElement.scrollWidth") <= width
    person.part("dark").click()
    person.keeps_picture(f"7-{name}-dark")
    person.page.close()


def test_bad_input_is_answered_in_words_and_the_page_lives_on(browser, server, folder, hidden_session, tmp_path):
    person = Person(browser, folder, 1280, 900)
    person.page.goto(f"{server.url}/open")
    person.page.get_by_label("path on this machine").fill("/no/such/folder")
    person.part("look").click()
    person.sees("checklist", "no such file or folder")
    broken = tmp_path / "broken"
    shutil.copytree(hidden_session, broken)
    lines = (broken / "samples.csv").read_text().splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[6], "what", 1)
    (broken / "samples.csv").write_text("\n".join(lines) + "\n")
    person.page.get_by_label("path on this machine").fill(str(broken))
    person.part("look").click()
    person.sees("checklist", "samples.csv")
    person.keeps_picture("8-bad-input")
    person.part("drop").locator("input[type=file]").set_input_files([str(p) for p in hidden_session.iterdir()])
    person.sees("checklist", "14 poses")
    person.part("open").click(timeout=LONG)
    person.sees("version-1")
    person.page.close()
    assert person.errors == []


def test_after_the_server_was_killed_the_work_is_taken_up_again(browser, server, folder):
    person = Person(browser, folder, 1280, 800)
    person.page.goto(server.url)
    person.sees("version-1")
    person.page.get_by_label("formula of an effect").focus()
    person.page.keyboard.type(HIDDEN, delay=20)
    person.page.keyboard.press("Enter")
    person.sees("trial", "The data support it")
    person.part("keep").click(timeout=LONG)
    person.sees("version-2")
    server.kill()
    try:
        person.page.get_by_text("Connection lost").wait_for(timeout=LONG)
        person.keeps_picture("9-killed")
    finally:
        server.start()
    person.part("resume").first.click(timeout=LONG)  # the tab comes back by itself
    person.sees("version-2", "formula_axis_1")
    person.page.close()


def test_the_page_for_the_cell_has_four_large_buttons_and_says_why_there_is_no_cell(browser, folder, tmp_path, monkeypatch):
    (tmp_path / "rclpy.py").write_text("raise ImportError('not here', name='rclpy')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    server = Server(tmp_path, "--cell", str(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"))
    person = Person(browser, folder, 820, 1180)
    try:
        person.page.goto(f"{server.url}/cell")
        person.sees("light", "ROS 2 or the messages of irec are not here")
        for name in ("check", "recalibrate", "go-back", "certificate"):
            box = person.part(name).bounding_box()
            assert box["height"] >= 90 and box["width"] >= 300
        assert person.part("check").is_disabled()
        person.part("certificate").click()
        person.sees("light", "no certificate yet")
        person.keeps_picture("10-cell")
        assert person.errors == []
    finally:
        server.kill()
        person.page.close()
