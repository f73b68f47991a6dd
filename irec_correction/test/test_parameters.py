# SPDX-License-Identifier: Apache-2.0
"""The parameter file that is shipped is what the node declares."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytestmark = pytest.mark.ros
FILE = Path(__file__).parents[2] / "config/nodes/correction.yaml"


def flat(tree: dict, prefix: str = "") -> dict:
    out = {}
    for key, value in tree.items():
        out |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def test_shipped_file_names_every_parameter_with_its_default():
    from irec_correction.nodes.parameters import PARAMETERS

    written = flat(yaml.safe_load(FILE.read_text())["correction_node"]["ros__parameters"])
    written.pop("use_sim_time")
    assert written == {p.name: p.default for p in PARAMETERS}


def test_every_number_has_a_range_that_holds_its_default():
    from irec_correction.nodes.parameters import PARAMETERS

    for p in PARAMETERS:
        if isinstance(p.default, (int, float)) and not isinstance(p.default, bool):
            assert p.low is not None and p.high is not None and p.low <= p.default <= p.high, p.name
