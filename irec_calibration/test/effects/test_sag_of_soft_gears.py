# SPDX-License-Identifier: Apache-2.0
"""How far a gear that is soft about zero torque sags under the weight, a session sees beside its references, and nobody else."""

from __future__ import annotations

import numpy as np
import pytest
from irec_calibration.diagnose.study import study_of
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.absolute import completed
from irec_calibration.identification.identify import observe
from irec_calibration.model import EIGHTEEN_DOF, Estimate, Term
from irec_calibration.robot.ratings import rated_torque
from synthetic import session
from test_ranges_of_soft_gears import SOFTER, gears

STIFFENING, AXIS, HARDENS, SHARE, BREAK = find_effect("joint_stiffening"), 2, -5e-7, 0.4, 0.02


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(session(6, seed=2))


def theta(scene: Scene, **values: float) -> np.ndarray:
    return np.array([values.get(p.name, p.start) for p in STIFFENING.parameters(scene)])


def soft(scene: Scene, share: float) -> np.ndarray:
    return theta(scene, **{f"a_{AXIS + 1}": HARDENS, f"w_{AXIS + 1}": share, "x_0": BREAK})


def test_under_a_weight_beyond_its_soft_range_it_is_a_zero_that_is_wrong(scene: Scene) -> None:
    weight = scene.tau_gravity[:, AXIS]
    far = weight > 4.0 * BREAK * rated_torque(scene.robot)[AXIS]
    assert np.count_nonzero(far) > 5
    sag = STIFFENING.displacement(scene, soft(scene, SHARE)) - STIFFENING.displacement(scene, soft(scene, 0.0))
    turned = -SHARE * HARDENS * np.abs(weight).max()
    np.testing.assert_allclose(sag[far], turned * scene.J[far, :, AXIS], rtol=2e-3, atol=1e-9)


def test_nothing_of_it_is_left_where_nobody_compares_with_a_reference(scene: Scene) -> None:
    at_the_tcp = scene_of(session(6, seed=2), observe="tcp")
    assert not at_the_tcp.view.sags
    np.testing.assert_array_equal(
        STIFFENING.displacement(at_the_tcp, soft(at_the_tcp, SHARE)), STIFFENING.displacement(at_the_tcp, soft(at_the_tcp, 0.0))
    )


def test_a_fit_has_it_of_each_axis_that_is_soft_and_of_no_other() -> None:
    observation = observe(session(6, seed=2))
    given = Term(STIFFENING, {"a_3": Estimate(HARDENS), "x_0": Estimate(BREAK), "slow": Estimate(0.0)})
    (whole,) = completed([given], observation)
    assert set(whole.estimates) == {"a_3", "w_3", "u_3", "x_0", "slow"}


def test_a_fit_finds_how_far_a_gear_stands_turned_beside_how_soft_it_is() -> None:
    """2 mrad about axis 3, which the weight turns to one side; without an unknown for it they are a joint zero that is wrong."""
    turned, fraction = 2e-3, 0.15

    def gear(scene: Scene) -> np.ndarray:
        stands = turned * np.tanh(scene.tau_gravity[:, AXIS] / (fraction * rated_torque(scene.robot)[AXIS]))
        return np.asarray(gears(scene, {AXIS: fraction}) + scene.J[:, :, AXIS] * stands[:, None])

    observation = observe(session(31, seed=5, extra=gear, approach=5e-3))
    law = Term(STIFFENING, {f"a_{AXIS + 1}": Estimate(0.0, upper=0.0), "x_0": Estimate(fraction), "slow": Estimate(0.0)})
    fit = study_of(observation, [*(Term(find_effect(i)) for i in EIGHTEEN_DOF), law])
    a, w = (fit.terms[-1].estimates[f"{name}_{AXIS + 1}"] for name in "aw")
    weight = np.abs(observation.scene.tau_gravity[:, AXIS]).max()
    assert a.value == pytest.approx(SOFTER, abs=4.0 * a.se)
    assert w.value == pytest.approx(-turned / (SOFTER * weight), abs=4.0 * w.se)
    assert w.se < 0.1
