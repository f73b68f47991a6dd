# SPDX-License-Identifier: Apache-2.0
"""Effects of packages and files: only who asks for a broken one is refused, and nobody takes the place of the catalogue."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest
from irec_calibration.effects import broken_effects, find_effect, known_effects, registry
from irec_calibration.effects.joint_torsion import JointTorsion
from irec_calibration.errors import EffectError
from irec_calibration.model import blank_model

MODULE = """
from irec_calibration.effects import Effect

class Sound(Effect):
    id = label = physics = "{id}"

    def parameters(self, scene):
        return ()

class Wrong:
    pass
"""


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Offers entry points as installed packages do."""
    monkeypatch.syspath_prepend(tmp_path)

    def offer(points: dict[str, str], module: str = "irec_test_plugin", effect_id: str = "sound_effect") -> None:
        (tmp_path / f"{module}.py").write_text(MODULE.format(id=effect_id))
        found = tuple(EntryPoint(name, value, registry.GROUP) for name, value in points.items())
        monkeypatch.setattr(registry, "_points", lambda: found)

    yield offer
    registry._load.cache_clear()


def test_one_broken_package_hinders_no_other_effect(installed):
    installed({"sound_effect": "irec_test_plugin:Sound", "broken": "irec_no_such_module:X"})
    assert [t.effect.id for t in blank_model(["joint_torsion", "sound_effect"])] == ["joint_torsion", "sound_effect"]
    assert "sound_effect" in known_effects() and "broken" not in known_effects()


def test_who_asks_for_a_broken_effect_is_told_which_package_and_why(installed):
    installed({"broken": "irec_no_such_module:X"})
    with pytest.raises(EffectError, match="'broken' of irec_no_such_module:X: can't be loaded: ModuleNotFoundError"):
        find_effect("broken")
    assert "irec_no_such_module" in broken_effects()["broken"]


def test_a_package_can_not_take_the_place_of_an_effect_of_the_catalogue(installed):
    installed({"joint_torsion": "irec_test_plugin2:Sound"}, "irec_test_plugin2", "joint_torsion")
    assert type(find_effect("joint_torsion")) is JointTorsion is type(known_effects()["joint_torsion"])
    assert "must choose another" in broken_effects()["joint_torsion"]


@pytest.mark.parametrize(("name", "value", "why"), [
    ("other", "irec_test_plugin3:Sound", "its id is 'third'; the entry point must have the same name"),
    ("third", "irec_test_plugin3:Wrong", "an Effect is needed"),
])  # fmt: skip
def test_a_badly_declared_effect_says_what_is_wrong(installed, name, value, why):
    installed({name: value}, "irec_test_plugin3", "third")
    with pytest.raises(EffectError, match=why):
        find_effect(name)


def test_an_effect_is_found_by_the_dotted_path_of_its_class_too(installed):
    installed({"fourth": "irec_test_plugin4:Sound"}, "irec_test_plugin4", "fourth")
    assert find_effect("irec_test_plugin4.Sound") is find_effect("fourth")
    assert find_effect("irec_calibration.effects.joint_torsion.JointTorsion").id == "joint_torsion"


def test_a_file_named_in_the_environment_is_known_to_every_program(monkeypatch, tmp_path):
    (tmp_path / "mine.py").write_text(MODULE.format(id="from_environment").replace("class Wrong:\n    pass\n", ""))
    with pytest.raises(EffectError, match="IREC_EFFECTS=FILE in the environment of a node"):
        find_effect("from_environment")
    monkeypatch.setenv("IREC_EFFECTS", str(tmp_path / "mine.py"))
    assert find_effect("from_environment").id == "from_environment"


def test_a_broken_file_named_in_the_environment_is_named_by_who_misses_its_effect(monkeypatch, tmp_path):
    (tmp_path / "bad.py").write_text("1 / 0\n")
    monkeypatch.setenv("IREC_EFFECTS", str(tmp_path / "bad.py"))
    assert find_effect("joint_torsion").id == "joint_torsion" and "joint_backlash" in known_effects()
    with pytest.raises(EffectError, match="'missing' is not known.*bad.py: ZeroDivisionError"):
        find_effect("missing")


def test_a_package_that_is_installed_while_the_process_runs_is_found(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(tmp_path)
    assert "late_effect" not in known_effects()
    (tmp_path / "irec_late_plugin.py").write_text(MODULE.format(id="late_effect"))
    about = tmp_path / "irec_late_plugin-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: irec_late_plugin\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{registry.GROUP}]\nlate_effect = irec_late_plugin:Sound\n")
    assert "late_effect" in known_effects() and find_effect("late_effect") is known_effects()["late_effect"]
    registry._load.cache_clear()


def test_the_packages_are_looked_through_once_and_not_in_each_fit(monkeypatch):
    known_effects()
    monkeypatch.setattr(registry, "entry_points", lambda **_: pytest.fail("looked through again"))
    assert "joint_torsion" in known_effects()
