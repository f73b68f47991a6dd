# SPDX-License-Identifier: Apache-2.0
"""The hard plants of both case studies stay where the paper's real cells were, on a few courses."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))

from case_parts import calibrated, ends, learned, left, tables  # noqa: E402
from case_parts.jobs import Case, Job, corrected, filters_of  # noqa: E402
from case_parts.moving import moving_session  # noqa: E402
from case_parts.story import courses_of  # noqa: E402
from case_parts.table import Drawn, Figures, figures, outside_bands, reduction  # noqa: E402
from irec_calibration.cell import read_cell  # noqa: E402
from irec_calibration.errors import IrecError  # noqa: E402
from irec_calibration.identification.observe import observe  # noqa: E402
from irec_calibration.model import EIGHTEEN_DOF, blank_model  # noqa: E402
from irec_calibration.model.file import save_model  # noqa: E402
from irec_calibration.recertification.judgement import residual_of  # noqa: E402
from irec_calibration.sensors.look_ahead import design  # noqa: E402
from irec_calibration.sensors.structure import frequency_response  # noqa: E402
from irec_calibration.session import read_session  # noqa: E402
from irec_sim.cellfile import CellFile  # noqa: E402
from irec_sim.cellfile import read_cell as read_sim_cell  # noqa: E402
from irec_sim.errors import SimError  # noqa: E402
from irec_sim.plant import Plant  # noqa: E402
from irec_sim.production.hard import CAUSES, Hard, read_hard, without  # noqa: E402
from irec_sim.production.modes import modes_of_cell  # noqa: E402
from irec_sim.production.runner import Drive, drive  # noqa: E402
from irec_sim.production.tap import shake  # noqa: E402
from irec_sim.production.ways import PERIOD, Ways, make_ways  # noqa: E402

from irec_calibration import diagnose  # noqa: E402

COURSES = {"afp": (4, 8, 24, 28), "machining": (2, 5, 7, 10)}


@dataclass(frozen=True)
class Calibrated:
    """The cell calibrated on its hard plant, and some courses driven without correction."""

    case: Case
    sim: CellFile
    hard: Hard
    session: Path
    ways: Ways
    uncorrected: Drive


def _calibrated(name: str, folder: Path) -> Calibrated:
    case = Case(name, folder)
    sim, cell = read_sim_cell(case.cell_path), read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    session = calibrated.measured_session(sim, cell, hard.truth, case.out / "session")
    calibrated.eighteen(session, case.out)
    ways = make_ways(sim, hard.process).only(np.array(COURSES[name]))
    return Calibrated(case, sim, hard, session, ways, drive(sim, hard, ways))


@pytest.fixture(scope="module")
def afp(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    return _calibrated("afp", tmp_path_factory.mktemp("afp"))


@pytest.fixture(scope="module")
def machining(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    return _calibrated("machining", tmp_path_factory.mktemp("machining"))


@pytest.mark.parametrize("name", ["afp", pytest.param("machining", marks=pytest.mark.long)])
def test_the_papers_own_correction_does_on_the_hard_plant_what_it_did_on_the_real_cell(
    name: str, request: pytest.FixtureRequest
) -> None:
    cell: Calibrated = request.getfixturevalue(name)
    controller = corrected(cell.case, Job("18dof", COURSES[name], str(cell.case.out / "model_18dof.yaml")), cell.ways)
    tolerance = read_cell(cell.case.cell_path).tolerance
    driven = drive(cell.sim, cell.hard, cell.ways, controller)
    before, after = (figures(d, tolerance) for d in (cell.uncorrected, driven))
    assert outside_bands(name, [before], [after]) == []
    ends = cell.ways.driving.sum(axis=0)
    assert len(set(ends)) > 1
    for i, end in enumerate(ends):  # an offset follows its course to the end, and stands from then on
        assert np.ptp(driven.sent[end - 5 : end, i], axis=0).max() > 0.0
        assert np.all(driven.sent[end:, i] == driven.sent[end - 1, i])
    assert controller.told()["active_share"] > 0.95  # the correction was in force, and no watchdog took it out
    assert controller.told()["findings"] == 0


def test_a_band_is_judged_on_the_mean_of_draws_and_its_uncertainty() -> None:
    within = Drawn("reduction of the maximum", "%", (64.5, 63.9, 57.3, 62.0, 65.3), (64.0, 76.0))
    assert within.mean < 64.0 and not within.outside  # two standard errors reach the band
    outside = replace(within, values=(61.9, 61.2, 54.9, 59.2, 60.0))
    assert outside.outside and "mean of 5 draws, 54.9 to 61.9" in outside.told
    assert replace(within, values=(63.9,)).outside  # one draw has no uncertainty
    assert not replace(within, values=(64.1,)).outside
    assert replace(within, values=(64.1,)).short == "64.1 %" and within.short == "62.6 +- 2.9 %"
    assert replace(within, values=(64.11, 64.13)).short == "64.1 +- less than 0.1 %"  # five draws alike are no certainty


def test_what_courses_leave_alike_is_told_from_the_others_and_not_from_the_course_itself() -> None:
    rng, steps, courses = np.random.default_rng(4), 2000, 12
    t = np.arange(steps) * PERIOD
    counted = np.stack([(t > 0.3) & (t < 4.0 + 0.3 * i) for i in range(courses)], axis=1)
    ends = np.array([t[np.flatnonzero(c)[-1]] for c in counted.T])
    cut = 1e-4 * np.exp(-(((t[:, None] - ends + 0.25) / 0.05) ** 2))  # at the same time before the end of each
    error = cut + rng.normal(0.0, 1e-5, cut.shape)
    error[:, 3] += 5e-4  # of this course alone
    told = left.common(SimpleNamespace(error=error, counted=counted))  # type: ignore[arg-type]
    np.testing.assert_allclose(told[counted].max(), 1e-4 + 5e-4 / 11, rtol=0.15)
    assert np.abs(told[:, 3]).max() < 1.2e-4  # nothing of its own
    there = cut > 0.9e-4
    assert error[there].mean() > 0.9e-4 and np.delete(np.where(there, error - told, 0.0), 3, axis=1).max() < 4e-5


def test_a_cutter_follows_forces_below_the_arms_lowest_mode_only(machining: Calibrated) -> None:
    """What the low-pass of roughing is for: at its own frequency the arm answers more than its compliance tells."""
    plant = Plant(machining.sim.chain, machining.hard.truth.physics().plant)
    assert machining.hard.modes is not None
    middle = machining.ways.q[len(machining.ways.q) // 3]
    lowest = min(modes_of_cell(machining.sim, plant, machining.hard.modes, q)[0][0] for q in middle)
    assert filters_of(machining.case).cutoff < 0.85 * lowest


def test_a_sensor_without_noise_and_lag_shows_no_teeth_in_its_samples(machining: Calibrated) -> None:
    ideal = without(machining.hard, "sensor noise and bandwidth", "sensor crosstalk and drift")
    few = machining.ways.only(np.array([0]))
    shown = drive(machining.sim, ideal, few)
    in_tool = (few.R_tool[:, 0].swapaxes(1, 2) @ shown.force[:, 0, :, None])[..., 0]
    np.testing.assert_allclose(shown.reading[:, 0], in_tool, atol=1.0)


def test_a_sensor_that_is_zeroed_in_the_air_reads_nothing_before_contact(afp: Calibrated) -> None:
    """Its bias has drifted by some newtons since it was zeroed last."""
    before = slice(5, 40)  # 0.16 s
    raw, zeroed = (np.abs(d.reading[before].mean(axis=0)) for d in (afp.uncorrected, afp.uncorrected.zeroed))
    assert raw.max() > 4.0 and zeroed.max() < 1.5


def test_fibre_placement_is_judged_at_the_papers_rate_and_roughing_at_every_step(afp: Calibrated, machining: Calibrated) -> None:
    driven = afp.uncorrected
    assert driven.judged.sum() / driven.counted.sum() == pytest.approx(100.0 * PERIOD, rel=0.01)
    at = np.flatnonzero(driven.judged[:, 0])
    assert set(np.diff(at)) == {2, 3} and not np.any(driven.judged & ~driven.counted)
    np.testing.assert_array_equal(machining.uncorrected.judged, machining.uncorrected.counted)
    assert figures(driven, 3e-4).max == 1e3 * np.abs(driven.error[driven.judged]).max()


@pytest.mark.parametrize("name", ["afp", "machining"])
def test_the_tracker_keeps_what_its_data_sheet_permits_at_most(name: str) -> None:
    """15 um + 6 um/m at 4 m; taken as three standard deviations."""
    case = Case(name, Path())
    tracker = read_hard(case.truth_path, read_sim_cell(case.cell_path)).tracker
    assert tracker is not None
    assert 3.0 * np.hypot(tracker.noise, tracker.slow) <= 15e-6 + 4.0 * 6e-6


@pytest.mark.long
def test_secondary_encoders_leave_the_structure_to_the_model_and_less_error(afp: Calibrated) -> None:
    """The joint angles behind the gears hold friction, play and creep already."""
    cell = read_cell(afp.case.cell_path)
    session = calibrated.link_session(afp.sim, cell, afp.hard.truth, afp.case.out / "session_links")
    beyond, whole = calibrated.beyond_links(session, afp.case.out), calibrated.eighteen(afp.session, afp.case.out)
    assert beyond.figures["cv_rms_m"] < 0.6 * whole.figures["cv_rms_m"]
    for axis in ("c_2", "c_3"):
        gear, left = (m.terms[0].estimates[axis].value for m in (whole, beyond))
        assert left < 0.25 * gear
    jobs = (
        Job("18dof", COURSES["afp"], str(afp.case.out / "model_18dof.yaml")),
        Job("links", COURSES["afp"], str(afp.case.out / "model_links.yaml"), links=True),
    )
    controllers = [corrected(afp.case, job, afp.ways) for job in jobs]
    by_force, by_links = (figures(drive(afp.sim, afp.hard, afp.ways, c), cell.tolerance) for c in controllers)
    assert by_links.mean < 0.75 * by_force.mean
    assert controllers[1].told()["findings"] == 0


@pytest.mark.parametrize(
    ("name", "disc", "least"),
    [("afp", None, 80.0), pytest.param("machining", calibrated.DISC, 80.0, marks=pytest.mark.long)],
)
def test_a_session_in_which_no_tracker_is_read_corrects_nearly_as_well(
    name: str, disc: tuple[float, float] | None, least: float, request: pytest.FixtureRequest
) -> None:
    """Under forces along the tool by itself, under forces across it where the disc's stiffness is known."""
    cell: Calibrated = request.getfixturevalue(name)
    model = calibrated.by_contact(cell.session, cell.case.out, disc)
    path = cell.case.out / ("model_contact.yaml" if disc is None else "model_contact_disc.yaml")
    assert ("disc_compliance" in model.effects) == (disc is None)
    controller = corrected(cell.case, Job("contact", COURSES[name], str(path)), cell.ways)
    tolerance = read_cell(cell.case.cell_path).tolerance
    before, after = (figures(d, tolerance) for d in (cell.uncorrected, drive(cell.sim, cell.hard, cell.ways, controller)))
    assert reduction(before, after)[0] > least
    assert controller.told()["findings"] == 0


def test_a_model_of_the_arm_in_motion_foretells_other_courses_better_than_one_of_the_standing_arm(afp: Calibrated) -> None:
    """Friction holds a part of the compliance of a standing arm only."""
    left = np.zeros(2)
    for rows, others in (((0, 2), (1, 3)), ((1, 3), (0, 2))):
        train, other = (
            moving_session(afp.sim.chain, [afp.uncorrected], np.array(r), afp.session, afp.case.out / f"moving_{rows[0]}_{r[0]}")
            for r in (rows, others)
        )
        observation = observe(read_session(other))
        for k, session in enumerate((afp.session, train)):
            model, _ = diagnose.solved(read_session(session), blank_model([*EIGHTEEN_DOF, "joint_backlash"]))
            left[k] += float(np.linalg.norm(residual_of(model, observation), axis=1).mean())
    assert left[1] < 0.85 * left[0]


@pytest.mark.long
def test_each_step_of_the_ladder_takes_the_mean_down_on_courses_that_it_was_not_learnt_from(afp: Calibrated) -> None:
    rows, lead = (6, 8, 9, 10, 11, 12), 0.033
    ways = make_ways(afp.sim, afp.hard.process).only(np.array(rows))
    dry = drive(afp.sim, afp.hard, ways).zeroed
    train, held = np.array([0, 1, 3, 5]), np.array([2, 4])
    session = moving_session(afp.sim.chain, [dry], train, afp.session, afp.case.out / "ladder")
    save_model(
        diagnose.solved(read_session(session), blank_model([*EIGHTEEN_DOF, "joint_backlash"]))[0], afp.case.out / "ladder.yaml"
    )
    profile = learned.profile_of([dry], train)
    force, noise = learned.unsteady(afp.case, dry, train, profile)
    others = ways.only(held)
    some = (9, 11)
    table = learned.write_profiles(profile, others, np.array(some), afp.case.out / "ladder.npz")
    found = design(force, 1.0 / PERIOD, lead, noise, compliance=3e-6, acceleration=0.17)
    jobs = [Job("standing", some, str(afp.case.out / "model_18dof.yaml"))]
    jobs.append(Job("moving", some, str(afp.case.out / "ladder.yaml")))
    jobs.append(replace(jobs[-1], zeroed=True))
    jobs.append(replace(jobs[-1], profiles=str(table), ahead=lead + 0.005, slack=2.0 * profile.spread))
    jobs.append(replace(jobs[-1], ahead=lead, taps=tuple((found.taps / found.taps.sum()).tolist())))
    left = []
    for job in jobs:
        controller = corrected(afp.case, job, others)
        left.append(1e3 * figures(drive(afp.sim, afp.hard, others, controller), 3e-4).mean)
        assert controller.told()["active_share"] > 0.999  # the model's range covers where the courses begin
    assert np.all(np.diff(left) < 1.0), left  # um
    assert left[-1] < 0.75 * left[0]


def test_an_offset_reaches_the_standing_arm_as_late_as_transport_and_drives_are(afp: Calibrated) -> None:
    k = 300
    sent, moved = shake(afp.sim, afp.hard, afp.ways.q[k, 1], float(afp.ways.rail[1]), seconds=9.0)
    f, _, H = frequency_response(sent, moved, 1.0 / PERIOD, 750)
    at = (f > 4.0) & (f < 7.0)
    delay = -np.angle(np.trace(H[at], axis1=1, axis2=2)) / (2.0 * np.pi * f[at])
    channel = afp.hard.channel
    assert channel is not None
    expected = channel.delay + 0.5 * channel.jitter + PERIOD + channel.servo_damping / (np.pi * channel.servo)
    assert float(np.median(delay)) == pytest.approx(expected, abs=0.006)


def test_too_few_courses_to_learn_from_are_refused_with_what_to_do() -> None:
    with pytest.raises(SimError, match="use --every 10 or less"):
        courses_of(Case("afp", Path(), every=16), 32)
    assert len(courses_of(Case("afp", Path(), every=10), 32)) == 4


def test_a_plant_out_of_its_bands_is_told() -> None:
    good, easy = Figures(0.57, 0.956, 0.1, 0.1, 0.0), Figures(0.004, 0.02, 0.0, 0.0, 1.0)
    assert outside_bands("afp", [good], [Figures(0.061, 0.285, 0.05, 0.05, 1.0)]) == []
    told = outside_bands("afp", [good], [easy])
    assert len(told) == 2 and "reduction of the mean is 99.3 %" in told[0]


def test_a_plant_of_linear_springs_is_driven_too(machining: Calibrated) -> None:
    """What the error budget ends with: the tool moves by the force at once, and by nothing else."""
    linear = without(machining.hard, *CAUSES)
    driven = drive(machining.sim, linear, machining.ways.only(np.array([0])))
    np.testing.assert_allclose(driven.deviation, driven.static, atol=1e-12)
    assert 1e-4 < float(np.abs(driven.deviation).max()) < 5e-3


@pytest.mark.parametrize("name", ["afp", "machining"])
def test_each_cause_of_a_hard_plant_can_be_switched_off(name: str) -> None:
    case = Case(name, Path())
    hard = read_hard(case.truth_path, read_sim_cell(case.cell_path))
    for cause in CAUSES:
        assert repr(without(hard, cause)) != repr(hard), cause
    assert without(hard, *CAUSES).truth.hidden == ()


def test_assumptions_of_a_plant_have_other_ends_and_the_shipped_one_keeps_to_its_ranges(tmp_path: Path) -> None:
    case = Case("afp", tmp_path)
    sim = read_sim_cell(case.cell_path)
    shipped = read_hard(case.truth_path, sim)
    told = {name: ends.at_end(case, name) for name in ends.ENDS}
    hard = {name: read_hard(c.truth_path, sim) for name, c in told.items()}
    assert repr(hard["as it is"]) == repr(shipped)
    assert len({repr(h) for h in hard.values()}) == len(ends.ENDS)
    assert len({c.out for c in told.values()}) == len(ends.ENDS)
    narrow, wide = (h.truth.physics().plant.backlash for h in (shipped, hard["play A1 0.29, A4 and A5 0.87 mrad"]))
    for joint, least, most in ((1, 0.3, 1.0), (4, 1.0, 3.0), (5, 1.0, 3.0)):  # arc minutes, full width
        width = 2.0 * np.array([narrow[joint - 1], wide[joint - 1]]) / ends.ARC_MINUTE
        np.testing.assert_allclose(width, [least, most], rtol=0.01)


def test_tables_are_told_from_summaries_and_refused_before_a_case_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = Case("machining", tmp_path)
    with pytest.raises(IrecError, match="run make case-machining first"):
        tables.print_tables([case], 1)
    row = asdict(Figures(0.6, 2.0, 0.3, 0.3, 0.5))
    after = asdict(Figures(0.06, 0.5, 0.1, 0.1, 1.0))
    drawn = Drawn("reduction of the mean", "%", (86.0, 88.0), (80.0, 87.0))
    names = ("18 DOF", tables.CONTACT, tables.CONTACT_DISC)
    summary = {
        "calibrated": "through the nodes: x", "draws": [asdict(drawn)], "table": {"without": row, **dict.fromkeys(names, after)},
        "ladder": {"once": [after], "first": [after, asdict(Figures(0.03, 0.3, 0.1, 0.1, 1.0))], tables.START: [row, row]},
    }  # fmt: skip
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    monkeypatch.setattr(tables, "_generated", lambda *_: ([drawn], ["80.0 %, 70.0 %"] * 3))
    tables.print_tables([case], 1)
    lines = capsys.readouterr().out.splitlines()
    assert "| roughing, through the nodes | 87.0 +- 2.0 % |" in lines
    assert "| roughing, through the nodes | 90.0 %, 75.0 % | 90.0 %, 75.0 % | 90.0 %, 75.0 % |" in lines
    assert "| roughing, generated | 80.0 %, 70.0 % | 80.0 %, 70.0 % | 80.0 %, 70.0 % |" in lines
    assert "| once | 90.0 %, 75.0 % |" in lines
    assert "| first | 92.5 +- 5.0 %, 80.0 +- 10.0 % |" in lines
