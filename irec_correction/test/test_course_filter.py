# SPDX-License-Identifier: Apache-2.0
"""A filter learnt from driven courses: it undoes delay and resonance of the axis that has them, within its acceleration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.conditioning import FilterSettings, make_filters
from irec_correction.course_filter import DrivenCourse, learn, spread_postures
from irec_correction.course_training import Answers, DrivenPart, Known, driven_course, known_along
from irec_correction.errors import SettingsError
from irec_correction.filters import low_pass
from irec_correction.fir import Fir, TapTable, nearness, read_taps, write_taps
from irec_correction.offset_answer import impulse, moved_by
from irec_correction.preview import ForceProfile, Preview
from scipy import signal

RATE = 250.0
COMPLIANCE = np.array([[2e-6, 5e-7, 0.0], [5e-7, 1e-6, 3e-7], [0.0, 3e-7, 5e-7]])


def force(seed: int, n: int = 6000) -> np.ndarray:
    sos = signal.butter(2, 5.0, fs=RATE, output="sos")
    return 60.0 * signal.sosfilt(sos, np.random.default_rng(seed).standard_normal((n, 3)), axis=0)


def second_order(hertz: float, damping: float, x: np.ndarray) -> np.ndarray:
    """x (k,) as an oscillator of unit gain follows it."""
    w = 2.0 * np.pi * hertz
    system = signal.cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / RATE)
    return np.asarray(signal.lfilter(np.ravel(system[0]), system[1], x))


def course(seed: int, late: int = 6) -> DrivenCourse:
    """An arm whose first axis is resonant, an offset that acts `late` samples later; what counts is the first direction."""
    f = force(seed)
    deviation = COMPLIANCE[0, 0] * second_order(9.0, 0.05, f[:, 0]) + COMPLIANCE[0, 1:] @ f[:, 1:].T
    return driven(deviation + 5e-4, f, seed, late)


def driven(deviation: np.ndarray, f: np.ndarray, seed: int, late: int) -> DrivenCourse:
    read = f + np.random.default_rng(seed + 1000).normal(0.0, 1.5, f.shape)
    moved = np.concatenate([np.zeros((late, 3, 3)), (COMPLIANCE[0][:, None] * read[:, None])[:-late]])
    used = np.zeros(len(f), dtype=bool)
    used[300:-10] = True
    return DrivenCourse(moved, deviation, np.tile(COMPLIANCE.T, (len(f), 1, 1)), read, np.ones((len(f), 1)), used)


def left(taps: np.ndarray, c: DrivenCourse) -> float:
    out = sum(signal.lfilter(taps[:, a, b], [1.0], c.moved[:, a, b]) for a in range(3) for b in range(3))
    rest = (c.deviation - out)[c.used]
    return float((rest - rest.mean()).std())


def test_what_was_learnt_holds_on_another_course_and_each_axis_gets_its_own() -> None:
    found, other = learn([course(1), course(2)], RATE, 2.0), course(3)
    plain = np.zeros((60, 3, 3))
    plain[0] = np.eye(3)
    shared = np.trace(found.taps[0], axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    assert left(found.taps[0], other) < 0.6 * left(plain, other)
    assert left(found.taps[0], other) < 0.9 * left(shared, other)
    assert left(found.taps[0], other) == pytest.approx(found.left, rel=0.2)  # what it says of itself is what comes
    assert found.left < found.before


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 1000), allowed=st.floats(0.2, 3.0), crossed=st.booleans())
def test_a_learnt_filter_passes_a_constant_force_unchanged_and_keeps_its_acceleration(
    seed: int, allowed: float, crossed: bool
) -> None:
    found = learn([course(seed)], RATE, allowed, taps=30, crossed=crossed)
    np.testing.assert_allclose(found.taps.sum(axis=1)[0], np.eye(3), atol=1e-9)
    assert found.acceleration <= allowed
    stage = make_filters(FilterSettings(posture_taps=found.taps.tolist()))[0]
    value = np.array([100.0, -50.0, 800.0, 1.0, 2.0, 3.0])
    for _ in range(40):
        out = stage.step(value)
    np.testing.assert_allclose(out, value, rtol=1e-9)


def test_what_a_force_sets_off_beside_its_own_deflection_is_answered_along_another_axis() -> None:
    """A force along the third axis moves nothing in the direction that counts as long as it stands, and swings there."""

    def swinging(seed: int) -> DrivenCourse:
        f = force(seed)
        return driven(3e-6 * (second_order(9.0, 0.05, f[:, 2]) - f[:, 2]) + COMPLIANCE[0] @ f.T, f, seed, 2)

    other = swinging(3)
    own, crossed = (learn([swinging(1), swinging(2)], RATE, 2.0, crossed=x).taps[0] for x in (False, True))
    assert COMPLIANCE[0, 2] == 0.0 and np.all(own[:, ~np.eye(3, dtype=bool)] == 0.0)
    assert left(crossed, other) < 0.6 * left(own, other)


class Springs:
    """A model of linear springs."""

    def __call__(self, q: np.ndarray, force: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
        return COMPLIANCE @ force, np.zeros(3)

    def reset(self) -> None:
        """Nothing to forget."""


def test_beside_a_known_force_the_filter_is_learnt_for_what_that_does_not_tell() -> None:
    """The known force is strong: a filter for the sum of both does most for the one that never passes it."""
    late, n = 6, 6000
    h = np.zeros((40, 3, 3))
    h[late] = np.eye(3)
    t = np.arange(n + late) / RATE
    known = 200.0 * np.sin(2.0 * np.pi * 1.2 * t)[:, None] * np.ones(3)

    def part(seed: int) -> DrivenPart:
        rest = force(seed)
        moved = (known[:n] + rest) @ COMPLIANCE.T
        moved[:, 0] += COMPLIANCE[0, 0] * (second_order(9.0, 0.05, rest[:, 0]) - rest[:, 0])
        counts, used = np.tile([1.0, 0.0, 0.0], (n, 1)), np.arange(n) >= 300
        read = known[:n] + rest + np.random.default_rng(seed + 1000).normal(0.0, 1.5, rest.shape)
        return DrivenPart(np.zeros((n, 2)), read, moved, counts, used, known=Known(known[:n], known[late:]))

    def courses(parts: list[DrivenPart]) -> list[DrivenCourse]:
        return [driven_course(Springs(), p, Answers(np.zeros((1, 2)), [h]), np.zeros((1, 2)), 1.0 / RATE) for p in parts]  # type: ignore[arg-type]

    parts = [part(1), part(2)]
    for_rest, for_all = (learn(courses(p), RATE, 0.05) for p in (parts, [replace(p, known=None) for p in parts]))
    (other,) = courses([part(3)])  # as it will be driven
    assert left(for_rest.taps[0], other) < 0.9 * left(for_all.taps[0], other)
    assert left(for_rest.taps[0], other) == pytest.approx(for_rest.left, rel=0.2)


def test_what_a_profile_tells_along_a_course_is_what_the_correction_adds() -> None:
    q, rng = np.linspace(0.0, 1.0, 500)[:, None], np.random.default_rng(3)
    wrench = np.zeros((500, 6))
    wrench[:, :3] = force(7, 500)
    profile, lead = ForceProfile(q, wrench), 0.04
    stages = [low_pass(20.0, 2, RATE)]
    known = known_along(Preview(profile, lead), q, rng.normal(0.0, 1.0, (500, 3)), stages)
    correction = Preview(profile, lead, [low_pass(20.0, 2, RATE)])
    added = np.array([correction.step(x)[:3] for x in q])
    np.testing.assert_allclose((known.ahead - known.now)[:-1], added[:-1], atol=1e-9)
    np.testing.assert_allclose(known.ahead[:-20], wrench[10:-10, :3], atol=1e-9)
    elsewhere = known_along(Preview(profile, lead), q + 5.0, np.ones((500, 3)), stages)
    assert not elsewhere.now.any() and not elsewhere.ahead.any()


def test_less_acceleration_costs_deviation() -> None:
    free = learn([course(4)], RATE, 50.0)
    held = learn([course(4)], RATE, 0.5 * free.acceleration)
    assert held.acceleration <= 0.5 * free.acceleration
    assert free.left < held.left
    with pytest.raises(SettingsError, match="allow more"):
        learn([course(4)], RATE, 1e-9)


def test_too_little_to_learn_from_is_refused() -> None:
    few = course(5)
    few.used[3500:] = False
    with pytest.raises(SettingsError, match="3200 samples are too few to learn 250 taps"):
        learn([few], RATE, 2.0, taps=250)
    with pytest.raises(SettingsError, match="2 to 250"):
        learn([course(5)], RATE, 2.0, taps=1)


def answer(f: np.ndarray, delay: float, mode: float) -> np.ndarray:
    """Drives with a delay, and an arm that is shaken by them along the first axis."""
    s = 2j * np.pi * f
    w = 2.0 * np.pi * mode
    drives = np.exp(-s * delay) / (1.0 + 2.0 * 0.9 * s / 88.0 + (s / 88.0) ** 2)
    H = drives[:, None, None] * np.eye(3)
    H[:, 0, 0] *= 1.0 - 0.5 * s**2 / (s**2 + 2.0 * 0.05 * w * s + w * w)
    return np.asarray(H)


def test_the_answer_to_an_offset_in_time_is_the_one_that_was_measured_over_frequency() -> None:
    f = np.fft.rfftfreq(2000, 1.0 / RATE)
    H = answer(f, 0.02, 10.0)
    told = H.copy()
    told[f < 3.0] = 0.0  # nothing was measured there
    h = impulse(f, told, RATE)
    np.testing.assert_allclose(h.sum(axis=0), np.eye(3), atol=1e-9)
    for hertz in (1.0, 5.0, 9.0, 12.0):
        got = np.exp(-2j * np.pi * hertz * np.arange(len(h)) / RATE) @ h.reshape(len(h), 9)
        want = H[int(np.argmin(np.abs(f - hertz)))].reshape(9)
        np.testing.assert_allclose(got, want, atol=0.15)


def test_an_offset_that_stands_has_moved_the_tcp_by_itself() -> None:
    f = np.fft.rfftfreq(2000, 1.0 / RATE)
    impulses = [impulse(f, answer(f, d, 10.0), RATE) for d in (0.02, 0.03)]
    near = nearness(np.array([[0.0, 0.0], [1.0, 0.0]]), np.stack([np.linspace(0, 1, 400), np.zeros(400)], axis=1))
    np.testing.assert_allclose(near.sum(axis=1), 1.0)
    offset = np.tile([1e-4, -2e-4, 3e-4], (400, 1))
    np.testing.assert_allclose(moved_by(impulses, near, offset), offset, atol=1e-9)


def test_an_answer_that_is_no_frequency_response_is_refused() -> None:
    with pytest.raises(SettingsError, match="from 0 to 125 Hz"):
        impulse(np.linspace(1.0, 30.0, 600), np.zeros((600, 3, 3), dtype=complex), RATE)


def test_each_posture_gets_the_taps_of_its_own_mode() -> None:
    """Two arms, at one joint angle each; the filter of both is as good at either as one that was learnt there alone."""
    near = {late: np.tile([[1.0, 0.0]] if late == 3 else [[0.0, 1.0]], (6000, 1)) for late in (3, 12)}
    both = learn([replace(course(late, late), near=near[late]) for late in (3, 12)], RATE, 2.0, taps=30)
    one = learn([course(late, late) for late in (3, 12)], RATE, 2.0, taps=30)
    for k, late in enumerate((3, 12)):
        other = course(20 + late, late)
        assert left(both.taps[k], other) < 0.95 * left(one.taps[0], other)


def test_a_filter_goes_from_the_taps_of_one_posture_to_those_of_the_next() -> None:
    taps = np.zeros((2, 2, 3))
    taps[0, 0], taps[1, 0], taps[1, 1] = 1.0, 2.0, -1.0
    stage = Fir(taps, RATE, np.array([[0.0, 0.0], [1.0, 0.0]]))
    found = []
    for x in np.linspace(0.0, 1.0, 21):
        stage.place(np.array([x, 0.0]))
        stage.reset()
        stage.step(np.zeros(6))
        found.append(stage.step(np.ones(6))[0])
    assert found[0] == pytest.approx(1.0, abs=1e-3) and found[-1] == pytest.approx(2.0, abs=1e-3)
    assert found[10] == pytest.approx(1.5) and (np.diff(found) > -1e-12).all()
    stage.place(np.zeros(3))  # of a robot with other joints: stays as it is
    assert stage.step(np.ones(6))[0] == pytest.approx(1.0)


def test_an_axis_is_filtered_from_the_others_too() -> None:
    taps = np.zeros((1, 3, 3, 3))
    taps[0, 0] = np.eye(3)
    taps[0, 1:, 0, 2] = 2.0, -2.0
    stage = Fir(taps, RATE, np.zeros((1, 2)))
    f = np.random.default_rng(1).standard_normal((40, 6))
    out = np.array([stage.step(x) for x in f])
    want = f.copy()
    want[2:, 0] += 2.0 * f[1:-1, 2] - 2.0 * f[:-2, 2]
    np.testing.assert_allclose(out[2:], want[2:])


def test_postures_are_spread_over_where_the_robot_was() -> None:
    q = np.concatenate([np.random.default_rng(k).normal(k, 0.01, (200, 2)) for k in range(3)])
    found = spread_postures(q, 3)
    np.testing.assert_allclose(np.sort(found[:, 0]), [0.0, 1.0, 2.0], atol=0.01)
    assert len(spread_postures(np.zeros((50, 2)), 3)) == 1


@pytest.mark.parametrize("shape", [(2, 5, 3), (2, 5, 3, 3)])
def test_taps_come_back_from_their_table(shape: tuple[int, ...], tmp_path: Path) -> None:
    path, joints = tmp_path / "filter.csv", ("joint_1", "joint_2")
    taps = np.random.default_rng(0).standard_normal(shape)
    table = TapTable(taps, np.array([[0.1, 0.2], [0.1, 0.3]]), joints)
    write_taps(path, table)
    again = read_taps(path, joints)
    np.testing.assert_allclose(again.taps, table.taps, rtol=1e-9)
    np.testing.assert_allclose(again.postures, table.postures)
    with pytest.raises(SettingsError, match="joint_3"):
        read_taps(path, (*joints, "joint_3"))
    path.write_text("force_x,force_y,force_z\n1.5,1.0,0.25\n-0.5,0.0,0.75\n")
    np.testing.assert_allclose(read_taps(path, joints).taps, [[[1.5, 1.0, 0.25], [-0.5, 0.0, 0.75]]])


@pytest.mark.parametrize(
    ("text", "word"),
    [("force_x,force_y\n1,1\n", "force_z"), ("", "it is empty"),
     ("joint_1,force_x,force_y,force_z\n0,1,1,1\n1,1,1,1\n1,0,0,0\n", "as many taps"),
     ("force_x,force_y,force_z,x_from_y\n1,1,1,0\n", "x_from_z")],
)  # fmt: skip
def test_a_table_that_is_no_filter_is_refused_with_its_name(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "filter.csv"
    path.write_text(text)
    with pytest.raises(SettingsError, match=word):
        read_taps(path, ("joint_1",))


@pytest.mark.parametrize(
    "taps", [np.ones((1, 2)), np.full((2, 3), np.nan), [[2.0, 1.0, 1.0]], np.zeros((0, 3)), np.ones((2, 1, 3)),
             np.ones((1, 1, 3, 3)), 1.0, np.eye(3)[None, None, :, :2]]
)  # fmt: skip
def test_taps_that_are_no_filter_are_refused(taps: list[list[float]]) -> None:
    with pytest.raises(SettingsError):
        Fir(np.array(taps), RATE)


def test_a_node_takes_its_designed_filter_from_a_table_and_no_second_one(tmp_path: Path) -> None:
    parameters = pytest.importorskip("irec_correction.nodes.parameters")
    path, joints = tmp_path / "filter.csv", ("joint_1", "joint_2")
    taps = np.zeros((2, 2, 3))
    taps[:, 0], taps[:, 1] = 1.5, -0.5
    write_taps(path, TapTable(taps, np.array([[0.0, 0.0], [1.0, 0.0]]), joints))
    given = {p.name: p.default for p in parameters.CORRECTION} | {"filter.file": str(path)}
    stages = make_filters(parameters.filter_settings(given, joints))
    assert [s.name for s in stages] == ["designed filter"]
    np.testing.assert_allclose(stages[0].taps, taps)  # type: ignore[attr-defined]
    assert not parameters.filter_settings(given | {"filter.file": ""}, joints).designed
    with pytest.raises(SettingsError, match="both given"):
        parameters.filter_settings(given | {"filter.taps": [1.5, -0.5]}, joints)
