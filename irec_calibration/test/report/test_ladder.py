# SPDX-License-Identifier: Apache-2.0
"""Before and after of an improvement: two models may leave out different samples as plainly wrong."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import session

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")
from irec_calibration.report import ladder as page

LEFT_OUT = {"before": [7], "after": [2, 9]}


def test_arrows_before_and_after_are_those_of_the_same_samples(tmp_path, monkeypatch):
    data = session(8)
    every = np.flatnonzero(data.load_case != 0)
    of = 1e-5 * np.arange(3.0 * len(data.pose)).reshape(-1, 3)  # tells the session row
    drawn = {}

    def compare(_, terms, sag_share):
        rows = np.delete(every, LEFT_OUT[terms])
        return SimpleNamespace(rows=rows, residual=of[rows])

    def residual_maps(p_tcp, residuals, titles, path, *, poses, on_surface):
        drawn.update(p_tcp=p_tcp, residuals=residuals, poses=poses)
        return path

    monkeypatch.setattr(page, "compare", compare)
    monkeypatch.setattr(page.samples, "residual_maps", residual_maps)
    rungs = [SimpleNamespace(model=SimpleNamespace(terms=name, sag_share=1.0, carried=None)) for name in LEFT_OUT]
    (section,) = page._before_after(SimpleNamespace(rungs=rungs), data, tmp_path)  # type: ignore[arg-type]
    rows = np.delete(every, [2, 7, 9])
    assert np.array_equal(drawn["p_tcp"], data.p_tcp_in_base[rows]) and np.array_equal(drawn["poses"], data.pose[rows])
    assert all(np.array_equal(r, of[rows]) for r in drawn["residuals"])
    assert "Only samples that" in section.figures[0].caption
