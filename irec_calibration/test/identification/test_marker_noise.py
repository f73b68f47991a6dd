# SPDX-License-Identifier: Apache-2.0
"""How the noise of an absolute session is shared out among its markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from absolute_sessions import session, torsion
from irec_calibration.diagnose.held_out import validated
from irec_calibration.identification.identify import default_terms
from irec_calibration.identification.marker_noise import at_level, by_marker
from irec_calibration.identification.observe import Observation, observe
from irec_calibration.session import Marker, Noise

MARKERS = (
    Marker("A", "tool0", (0.03, -0.02, 0.1), known=False), Marker("B", "tool0", (-0.1, 0.05, 0.0), known=False),
    Marker("F", "base_link", (0.3, 0.1, 0.0), known=False),
)  # fmt: skip
OWN = np.array([2e-5, 4e-5, 3e-5])  # m, of each marker
COMMON = 5e-5  # m, of the markers on the tool of a pose


def drawn(observation: Observation, seed: int) -> np.ndarray:
    """Noise of the rows, (m, 3), m."""
    rng = np.random.default_rng(seed)
    marker = observation.session.marker[observation.rows]
    _, pose = np.unique(observation.pose, return_inverse=True)
    shared = COMMON * rng.standard_normal((pose.max() + 1, 3))[pose]
    return OWN[marker][:, None] * rng.standard_normal((len(marker), 3)) + shared * (marker < 2)[:, None]


def sizes(observation: Observation) -> np.ndarray:
    """What three markers have by themselves, and what those on the tool have in common, over the first, (3,)."""
    marker = observation.session.marker[observation.rows]
    whiten = observation.whiten
    own = [np.median(whiten.sigma[marker == m]) for m in range(3)]
    return np.array([own[1], own[2], np.median(whiten.sigma_reference[marker < 2])]) / own[0]


# what two markers have apart from each other tells their mean square only
BOTH = np.sqrt((OWN[:2] ** 2).mean())
TRUE = np.array([BOTH, OWN[2], COMMON]) / BOTH


def test_noise_is_shared_out_as_it_is() -> None:
    plain = observe(session(poses=400, markers=MARKERS))
    found = [sizes(by_marker(plain, drawn(plain, seed))) for seed in range(10)]
    np.testing.assert_allclose(np.mean(found, axis=0), TRUE, rtol=0.05)


def test_no_marker_is_better_known_than_half_of_what_its_instrument_is_stated_to_see() -> None:
    """A marker on the base that a model fits to a micrometre, beside markers on the tool that it misses by a millimetre."""
    plain = observe(session(poses=40, markers=MARKERS, noise=Noise(tracker_m=2e-5, robot_m=1e-4)))
    marker = plain.session.marker[plain.rows]
    residual = np.where(marker < 2, 1e-3, 1e-6)[:, None] * np.random.default_rng(3).standard_normal((len(marker), 3))
    shared_out = by_marker(plain, residual)
    found = at_level(shared_out, 2.0).whiten
    assert found.sigma[marker == 2].min() == pytest.approx(1e-5)
    np.testing.assert_allclose(found.sigma[marker < 2], 2.0 * shared_out.whiten.sigma[marker < 2])
    assert found.level == 2.0


def test_what_a_fit_takes_up_of_the_noise_is_added_again() -> None:
    plain = observe(session(poses=40, markers=MARKERS))
    rng = np.random.default_rng(5)
    _, pose = np.unique(plain.pose, return_inverse=True)
    on_tool = (plain.session.marker[plain.rows] < 2).astype(float)
    # functions of the pose, which move both markers on the tool alike: half of what they have in common is taken up
    columns = (rng.standard_normal((pose.max() + 1, 3, 60))[pose] * on_tool[:, None, None]).reshape(-1, 60)
    believed = by_marker(plain, drawn(plain, 1)).whiten
    white = believed(columns.reshape(-1, 3, 60)).reshape(-1, 60)
    Q = np.linalg.qr(white)[0]
    with_it, without = [], []
    for seed in range(40):
        noise = believed(drawn(plain, seed)).ravel()
        residual = believed.undo((noise - Q @ (Q.T @ noise)).reshape(-1, 3))
        taken_up = believed.undo(Q.reshape(-1, 3, 60))
        at = replace(plain, whiten=believed)
        with_it.append(sizes(by_marker(at, residual, taken_up)))
        without.append(sizes(by_marker(at, residual)))
    np.testing.assert_allclose(np.mean(with_it, axis=0), TRUE, rtol=0.06)
    assert np.mean(without, axis=0)[2] < 0.8 * TRUE[2]


def test_what_the_model_lacks_does_not_pass_for_noise_that_markers_have_in_common() -> None:
    made = session(poses=80, markers=MARKERS, noise=Noise(tracker_m=1.5e-5), moved=torsion(np.array([0, 8e-6, 1.2e-5, 0, 0, 0])))
    found = validated(made, default_terms(made)).study.observation.whiten
    assert found.sigma_reference.max() < 1.5e-5
    assert np.allclose(np.median(found.sigma), 1.5e-5, rtol=0.3)
