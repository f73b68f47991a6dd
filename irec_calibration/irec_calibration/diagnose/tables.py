# SPDX-License-Identifier: Apache-2.0
"""Tables (CSV) beside a diagnosis: residuals per sample, candidates, views."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..files import write_file
from ..session.data import Session
from .result import Comparison, Diagnosis


def write_tables(result: Diagnosis, session: Session, folder: str | Path) -> None:
    """residuals.csv, candidates.csv and where.csv in a folder."""
    folder = Path(folder)
    write_comparison(result.comparison, session, folder / "residuals.csv")
    _write(
        folder / "candidates.csv",
        ("effect", "parts", "cv_rms_m", "cv_rms_se_m", "log_evidence", "p_value", "plausible", "confusable_with"),
        (
            (
                c.effect,
                "; ".join(c.groups),
                c.cv_rms_m,
                c.cv_rms_se_m,
                c.log_evidence,
                c.p_value,
                c.plausible,
                "; ".join(c.confusable_with),
            )
            for c in result.candidates
        ),
    )
    _write(
        folder / "where.csv",
        ("view", "value", "rms_m", "share", "p_value", "sentence"),
        ((v.view, v.value, v.rms_m, v.share, v.p_value, v.sentence) for v in result.where),
    )


def write_comparison(c: Comparison, session: Session, path: Path) -> None:
    """Measured, predicted and left over for each sample, m, in base_link."""
    keys = [f"{what}_{a}" for what in ("measured", "predicted", "residual") for a in "xyz"]
    rows = (
        (session.pose[r], session.load_case[r], session.repeat[r], *c.measured[i], *c.predicted[i], *c.residual[i])
        for i, r in enumerate(c.rows)
    )
    _write(path, ("pose", "load_case", "repeat", *keys), rows)


def _write(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow(header)
    for row in rows:
        table.writerow(["" if isinstance(v, float) and v != v else f"{v:.6e}" if isinstance(v, float) else v for v in row])
    write_file(path, text.getvalue())
