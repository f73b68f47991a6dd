# SPDX-License-Identifier: Apache-2.0
"""Figures and pages: files that can be opened, complete in themselves, with text escaped."""

from __future__ import annotations

import numpy as np
import pytest
from irec_calibration.identification.identify import identify
from irec_calibration.model import EIGHTEEN_DOF, SIX_DOF, Estimate, blank_model
from synthetic import session

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")
from irec_calibration.report import models, samples
from irec_calibration.report.page import Figure, Page, Section, Table, write_page

PNG = b"\x89PNG"


def test_a_page_holds_its_figures_and_names_nothing_outside(tmp_path):
    figure = models.ladder(["6 DOF", "18 DOF"], [9e-5, 3e-5], [5e-6, 2e-6], [False, True], 2.5e-5, tmp_path / "ladder.png")
    page = Page("Title <b>", "sub", "the tool bends & twists", "missing_effect",
                [Section("Ladder", ["text"], [Figure(figure, "caption")],
                         [Table(["a", "b"], [["x<y", 1.23456], [None, 2]])])])  # fmt: skip
    text = write_page(page, tmp_path / "report.html").read_text()
    assert "data:image/png;base64," in text and "Title &lt;b&gt;" in text and "x&lt;y" in text and ">1.23<" in text
    assert "http" not in text.replace("http-equiv", "")


def test_each_figure_of_samples_is_written(tmp_path):
    data = session(8)
    six, eighteen = (identify(data, blank_model(e)) for e in (SIX_DOF, EIGHTEEN_DOF))
    o = six.observation
    written = [
        samples.norms_per_sample(o.of(o.scene.p_tcp), six.residual, o.whiten.floor, tmp_path / "a.png", poses=o.pose),
        samples.predicted_against_measured(o.y, o.y - six.residual, tmp_path / "b.png"),
        samples.residual_maps(o.scene.p_tcp[o.rows], [six.residual, eighteen.residual], ["6 DOF", "18 DOF"], tmp_path / "c.png"),
        samples.residual_against(
            o.scene.tau[o.rows, 1], six.residual, "torque of axis 2 [N m]", o.whiten.floor, tmp_path / "d.png"
        ),
        models.candidates(["a", "b"], [3e-5, 5e-5], [2e-6, 3e-6], 6e-5, 2e-5, ["a"], tmp_path / "e.png"),
        models.views(["load case N", "torque of axis 3"], [0.4, 0.2], tmp_path / "f.png"),
        models.course({"off": np.arange(9.0)}, {"off": np.ones(9) * 5e-4}, 3e-4, tmp_path / "g.png"),
    ]
    assert all(path.read_bytes().startswith(PNG) for path in written)


def test_a_value_is_written_with_its_error_and_unit_where_it_has_them():
    assert str(Estimate(1.234567e-7, 1.2e-8, "rad/(N m)")) == "1.23e-07 +- 1.2e-08 rad/(N m)"
    assert str(Estimate(0.036, unit="share of rated torque")) == "0.036 share of rated torque"
    assert str(Estimate(-0.026, 0.003, "1")) == "-0.026 +- 0.003"


def test_the_first_screen_holds_verdict_figure_and_what_to_do(tmp_path):
    figure = models.gap([("model as it is", 9e-5, 3e-6), ("with it", 3e-5, 2e-6)], 2.5e-5, tmp_path / "gap.png", "title")
    page = Page("T", verdict="It bends.", hero=Figure(figure, "one figure"), todo=[("Add it:", "irec add m.yaml e s")],
                sections=[Section("Evidence")])  # fmt: skip
    text = write_page(page, tmp_path / "report.html").read_text()
    places = [text.index(what) for what in ("It bends.", "one figure", "irec add m.yaml e s", "Evidence")]
    assert places == sorted(places)


def test_a_page_prints_on_a4(tmp_path):
    text = write_page(Page("T"), tmp_path / "report.html").read_text()
    assert "size: A4" in text and "break-inside: avoid" in text


def test_nothing_is_drawn_of_a_commanded_motion_that_is_not_there(tmp_path, recwarn):
    residual = np.ones((12, 3)) * 1e-5
    samples.norms_per_sample(np.zeros((12, 3)), residual, 1e-5, tmp_path / "a.png", poses=np.repeat([1, 2, 3], 4))
    assert [str(w.message) for w in recwarn if issubclass(w.category, UserWarning)] == []


@pytest.mark.parametrize("rows", [1, 4])
def test_a_map_of_one_pose_is_drawn(tmp_path, rows):
    one = np.tile([1.0, 0.2, 0.7], (rows, 1))
    path = samples.residual_maps(one, [1e-5 * one], ["Residual"], tmp_path / "m.png", poses=np.ones(rows, dtype=int))
    assert path.read_bytes().startswith(PNG)


def test_a_map_of_many_samples_draws_one_arrow_for_each_pose(tmp_path):
    many = np.random.default_rng(0).normal(size=(900, 3))
    path = samples.residual_maps(many, [1e-5 * many], ["Residual"], tmp_path / "m.png", poses=np.repeat(np.arange(90), 10))
    assert path.read_bytes().startswith(PNG)
