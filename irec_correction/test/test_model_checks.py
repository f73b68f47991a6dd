# SPDX-License-Identifier: Apache-2.0
"""A model comes into force only if it is plausible; whatever is in the file, it is refused with a reason."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from chain import PERIOD, ROBOT, model
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from irec_calibration.effects import find_effect
from irec_calibration.effects.production import production_scene
from irec_calibration.errors import ModelError
from irec_calibration.model import Envelope, Estimate, Term
from irec_calibration.model.file import save_model
from irec_calibration.model.plausibility import check_envelope
from irec_calibration.recertification.store import Store
from irec_calibration.robot import Robot
from irec_correction.errors import ActivationError, SettingsError
from irec_correction.nodes.model_checks import Mounted, calibration_in_force, read_checked

MOUNTED = Mounted(ROBOT, "S-1", "roller", (0.0, 0.0, -9.81), None, PERIOD)


def written(folder: Path, change=lambda data: None) -> Path:
    """The model of the tests as a file, changed."""
    (folder / "model.yaml").unlink(missing_ok=True)  # what is no model any more is not replaced by one
    path = save_model(replace(model(), tool="roller"), folder / "model.yaml")
    data = yaml.safe_load(path.read_text())
    change(data)
    path.write_text(yaml.safe_dump(data))
    return path


def parameter(name: str, value: object):
    def change(data: dict) -> None:
        for effect in data["effects"]:
            if name in effect["parameters"]:
                effect["parameters"][name] = {"value": value, "unit": "rad/(N m)"}

    return change


def every_compliance(factor: float):
    def change(data: dict) -> None:
        for effect in data["effects"]:
            for entry in effect["parameters"].values():
                entry["value"] *= factor

    return change


def put(value: object, *keys: object):
    def change(data: dict) -> None:
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


def test_a_sound_model_is_accepted_with_its_largest_offset(tmp_path):
    checked = read_checked(written(tmp_path), MOUNTED)
    assert 2e-4 < checked.largest_offset < 5e-3
    assert not checked.changed()
    written(tmp_path, every_compliance(1.1))
    assert "was changed" in checked.changed()


def test_what_a_model_is_to_be_taken_with_is_known_when_it_comes_into_force(tmp_path):
    says = "the deflection is predicted to 9 um where the reflector is, but only to 62 um at the TCP"
    assert read_checked(written(tmp_path), MOUNTED).caution == ""
    assert read_checked(written(tmp_path, put(says, "made", "caution")), MOUNTED).caution == says


def test_a_file_larger_than_any_model_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / "model.yaml"
    path.write_text("a: [" + "1," * 1_900_000 + "1]\n")
    monkeypatch.setattr("irec_correction.nodes.model_checks.load_model", lambda _: pytest.fail("read"))
    with pytest.raises(ActivationError, match=r"has 3800007 bytes; a model that is put in force has 64000 at most"):
        read_checked(path, MOUNTED)


def test_a_soft_place_of_a_rail_is_taken_wherever_on_the_rail_it_is(tmp_path):
    rail = find_effect("rail_compliance")
    names = [p.name for p in rail.parameters(production_scene(ROBOT, np.array([0.0, 0.0, -9.81])))]
    for place, taken in ((0.9, True), (-3.0, True), (500.0, False)):
        values = {n: Estimate(1e-9) for n in names} | {"s_0": Estimate(place), "w": Estimate(0.4)}
        made = model()
        path = tmp_path / f"{place}.yaml"
        save_model(replace(made, tool="roller", terms=(*made.terms, Term(rail, values))), path)
        if taken:
            assert read_checked(path, MOUNTED).largest_offset > 0.0
        else:
            with pytest.raises((ModelError, ActivationError), match="s_0 is 500"):
                read_checked(path, MOUNTED)


def test_the_calibration_in_force_is_found_beside_the_cell_file_and_refused_where_it_was_changed(tmp_path):
    cell, store = tmp_path / "cell.yaml", Store(tmp_path / "calibrations", "S-1")
    assert calibration_in_force(str(cell), "calibrations", "S-1") is None
    (tmp_path / "new").mkdir()
    written(tmp_path / "new")
    store.put_in_force(store.add(tmp_path / "new", "recalibrated", "M").calibration, "M")
    path = calibration_in_force(str(cell), "calibrations", "S-1")
    assert path == store.model_path("0001")
    path.write_text(path.read_text() + "# by hand")
    with pytest.raises(ModelError, match="was changed since it came into the store"):
        calibration_in_force(str(cell), "calibrations", "S-1")
    with pytest.raises(SettingsError, match="needs parameter 'cell'"):
        calibration_in_force("", "calibrations", "S-1")


NAN = float("nan")
IMPLAUSIBLE = {
    "no serial": (put("", "robot", "serial"), "serial is empty"),
    "no hash": (put("", "robot", "urdf_sha256"), "urdf_sha256 is empty"),
    "another serial": (put("S-2", "robot", "serial"), "'S-2'"),
    "another hash": (put("0" * 64, "robot", "urdf_sha256"), "another robot description"),
    "another tool": (put("spindle", "robot", "tool"), "'spindle'"),
    "no tool": (put("", "robot", "tool"), "'roller' is mounted; identify it again from a session with 'tool: roller'"),
    "NaN envelope": (put(NAN, "envelope", "q_lower", 0), "q_lower"),
    "envelope of five": (put([0.0] * 5, "envelope", "q_lower"), "q_lower"),
    "envelope turned round": (put([9.0] * 6, "envelope", "q_lower"), "q_lower"),
    "force of the envelope": (put(NAN, "envelope", "force"), "force"),
    "no envelope": (put(None, "envelope"), "envelope"),
    "negative": (parameter("c_1", -1e-3), "c_1 is -0.001"),
    "too soft": (every_compliance(5000.0), "to 1.37"),
    "NaN": (parameter("c_1", NAN), "c_1"),
    "unknown parameter": (put({"value": 1e-7}, "effects", 0, "parameters", "c_9"), "'c_9'"),
}


@pytest.mark.parametrize("case", IMPLAUSIBLE)
def test_an_implausible_model_is_refused_with_the_figure(case, tmp_path):
    change, text = IMPLAUSIBLE[case]
    with pytest.raises(ActivationError) as refused:
        read_checked(written(tmp_path, change), MOUNTED)
    assert text in str(refused.value) and "model.yaml" in str(refused.value)


@pytest.mark.parametrize(("envelope", "text"), [
    (Envelope((NAN, *[0.0] * 5), (1.0,) * 6, 100.0), "q_lower of joint_1 is nan"),
    (Envelope((0.0,) * 5, (1.0,) * 6, 100.0), "5 joints"),
    (Envelope((0.0,) * 6, (1.0,) * 6, NAN), "force of nan"),
    (Envelope((0.0,) * 6, (1.0,) * 6, 0.0), "force of 0"),
    (Envelope((0.0,) * 6, (1.0,) * 6, 100.0, float("inf")), "torque of inf"),
])  # fmt: skip
def test_an_envelope_that_is_not_well_formed_is_refused(envelope, text):
    with pytest.raises(ModelError, match=text):
        check_envelope(envelope, ROBOT)


def test_where_the_ratings_are_unknown_the_predicted_offset_is_the_bound(tmp_path):
    import re

    unrated = Robot(re.sub(r'effort="[^"]*"', 'effort="0"', ROBOT.urdf_text), "without ratings")
    mounted = replace(MOUNTED, robot=unrated)
    hashed = put(unrated.sha256, "robot", "urdf_sha256")
    assert read_checked(written(tmp_path, hashed), mounted).largest_offset > 0.0

    def soft(data: dict) -> None:
        hashed(data)
        every_compliance(5000.0)(data)

    with pytest.raises(ActivationError, match=r"predicts a deflection of .* mm .* 20 mm is the limit"):
        read_checked(written(tmp_path, soft), mounted)


def test_a_limit_of_the_cell_for_the_predicted_offset_is_kept(tmp_path):
    with pytest.raises(ActivationError, match=r"0\.1 mm is the limit"):
        read_checked(written(tmp_path), replace(MOUNTED, largest_offset=1e-4))


def test_where_the_mounted_tool_is_not_known_that_of_the_model_is_not_looked_at(tmp_path):
    for tool in ("roller", ""):
        assert read_checked(written(tmp_path, put(tool, "robot", "tool")), replace(MOUNTED, tool="")).largest_offset > 0.0


def test_a_robot_without_a_serial_takes_no_model(tmp_path):
    with pytest.raises(ActivationError, match="serial of this robot is not known"):
        read_checked(written(tmp_path), replace(MOUNTED, serial=""))


MALFORMED = {
    "robot is a list": put([1], "robot"),
    "parameters are a list": put([1], "effects", 0, "parameters"),
    "history is a number": put(5, "history"),
    "made is a text": put("yesterday", "made"),
    "envelope of texts": put(["a"] * 6, "envelope", "q_lower"),
    "a combination without a sum": put([{"value": 1.0}], "known_only_in_combination"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_model_is_refused_or_read_but_never_raises_anything_else(case, tmp_path):
    try:
        read_checked(written(tmp_path, MALFORMED[case]), MOUNTED)
    except ActivationError as error:
        assert "model.yaml" in str(error)


@pytest.mark.parametrize("text", [
    "[" * 3000, "format: irec-model/1\nmade: {date: 2024-13-45}", "&a [*a]", "\0", "", "format: irec-model/1\neffects: 7",
])  # fmt: skip
def test_text_that_is_no_model_is_refused(text, tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(text)
    with pytest.raises(ActivationError, match="model.yaml"):
        read_checked(path, MOUNTED)


@pytest.mark.parametrize("path", ["/dev/zero", "/", "/nowhere/model.yaml", "a\0b"])
def test_what_is_no_regular_file_is_refused(path):
    with pytest.raises(ActivationError):
        read_checked(path, MOUNTED)


values = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=4), st.just([]), st.just([1]), st.just({}),
    st.just({"value": 1e300}), st.floats(-1.0, 1.0).map(lambda v: {"value": v}),
)  # fmt: skip


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, 60), values), min_size=1, max_size=3))
def test_whatever_is_changed_in_a_model_it_is_accepted_as_plausible_or_refused_with_a_reason(tmp_path, changes):
    def change(data: dict) -> None:
        for at, value in changes:
            places = list(_places(data))
            holder, key = places[at % len(places)]
            holder[key] = copy.deepcopy(value)  # one and the same list twice could come to hold itself

    try:
        checked = read_checked(written(tmp_path, change), MOUNTED)
    except ActivationError as error:
        assert str(error)
        return
    assert checked.largest_offset <= MOUNTED.largest_offset
    assert checked.model.serial == "S-1" and isinstance(checked.model.envelope, Envelope)


def _places(data: object):
    """Every (container, key) of a tree."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in list(items):
        yield data, key
        yield from _places(value)


def test_a_model_as_it_was_written_has_no_doubts_and_its_tool_may_be_named_by_hand(tmp_path):
    assert read_checked(written(tmp_path), MOUNTED).doubts == ()
    assert read_checked(written(tmp_path, put("roller", "robot", "tool")), MOUNTED).doubts == ()


def without_digest(data: dict) -> None:
    """As a model of an older version."""
    del data["values_sha256"]


@pytest.mark.parametrize(
    "change", [every_compliance(3.0), put([3.1] * 6, "envelope", "q_upper"), put(1100.0, "envelope", "force")]
)  # fmt: skip
def test_values_that_were_changed_by_hand_are_told(tmp_path, change):
    checked = read_checked(written(tmp_path, change), MOUNTED)
    assert "were changed by hand after the file was written" in checked.doubts[0] and checked.doubts[0] in checked.caution

    def as_of_old(data: dict) -> None:
        change(data)
        without_digest(data)

    assert "changed by hand" not in read_checked(written(tmp_path, as_of_old), MOUNTED).caution


def test_a_model_that_corrects_nothing_and_one_that_reaches_beyond_the_joints_are_told(tmp_path):
    nothing = model(0.0)
    bending = nothing.terms[1]
    stiff = replace(bending, estimates={n: replace(e, value=0.0) for n, e in bending.estimates.items()})
    path = save_model(replace(nothing, tool="roller", terms=(nothing.terms[0], stiff)), tmp_path / "zero.yaml")
    assert read_checked(path, MOUNTED).doubts == ("all its compliances are 0: it corrects nothing",)
    wide = replace(model(), tool="roller", envelope=Envelope((-6.2,) * 6, (6.2,) * 6, 1200.0))
    doubts = read_checked(save_model(wide, tmp_path / "wide.yaml"), MOUNTED).doubts
    assert "its envelope of joint_2 is -6.200 .. 6.200 rad, the joint can be at" in " ".join(doubts)
