# SPDX-License-Identifier: Apache-2.0
"""What tilts the arm's bearings and the ground under it, in forms of no effect, is told from a base that gives way."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.diagnose.family import family_of
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import default_terms
from irec_calibration.session import Session
from irec_calibration.typing import Array


def tilted(scene: Scene, about: Array, angle: Array) -> Array:
    """Displacement of the marker where base_link turns about unit vectors (n, 3) through its origin by angles (n,), (n, 3), m."""
    return np.cross(about, scene.p_observed) * angle[:, None]


def moment(scene: Scene) -> Array:
    """Of process and gravity about the origin of base_link, (n, 3), N m."""
    return np.cross(scene.p_tcp, scene.force) + scene.gravity.wrench_at_base[1]


def a_foot_lifts(scene: Scene) -> Array:
    about = np.tile([np.cos(1.0), np.sin(1.0), 0.0], (len(scene), 1))
    return tilted(scene, about, 1e-7 * np.maximum(np.einsum("ni,ni->n", moment(scene), about) - 3500.0, 0.0))


def a_slewing_ring_with_two_soft_places(scene: Scene) -> Array:
    """The bearing of axis 1, softer about one of its axes at two places of its turn."""
    about = scene.kin.virtual_axis[:, 0, 0]
    return tilted(scene, about, 1e-6 * np.sin(2.0 * scene.q[:, 0]) * scene.tau_virtual[:, 0])


def strongest(session: Session) -> str:
    study = prepare(session, default_terms(session)).to_weigh
    family = family_of(study)
    gains, _ = family.gains(Ground(study.bench, study.base))
    return family.structures[int(np.argmax(gains - np.log([s.tried for s in family.structures])))].words


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        (a_foot_lifts, "tilting base_link on the ground"),
        (a_slewing_ring_with_two_soft_places, "tilting the link of axis 1 across it, by its moment and over its turn"),
    ],
)
def test_a_structure_has_its_form(cause, words: str) -> None:
    assert strongest(synthetic.session(31, 4, extra=cause)).startswith(words)


@pytest.mark.parametrize("cause", [a_foot_lifts, a_slewing_ring_with_two_soft_places])
def test_it_is_no_base_that_gives_way(cause) -> None:
    verdict = diagnose(synthetic.session(31, 4, extra=cause)).verdict
    assert (verdict.status, verdict.effects) == ("unexplained", ()), verdict.text
    assert {"load_case", "joint_1"} & {*verdict.depends_on}


def test_a_base_that_gives_way_is_named_all_the_same() -> None:
    def soft_ground(scene: Scene) -> Array:
        about = np.tile([0.6, 0.8, 0.0], (len(scene), 1))
        change = moment(scene) - moment(scene)[scene.reference]
        return tilted(scene, about, 2e-7 * np.einsum("ni,ni->n", change, about))

    verdict = diagnose(synthetic.session(31, 4, extra=soft_ground)).verdict
    assert (verdict.status, verdict.effects) == ("missing_effect", ("base_compliance",)), verdict.text
