# SPDX-License-Identifier: Apache-2.0
"""The parameter files and the page that are shipped are what the nodes declare."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
import yaml

pytestmark = pytest.mark.ros
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def written() -> Any:
    spec = importlib.util.spec_from_file_location("node_parameters", ROOT / "tools/docs/node_parameters.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def flat(tree: dict, prefix: str = "") -> dict:
    out = {}
    for key, value in tree.items():
        out |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return out


def shipped(name: str) -> dict[str, dict]:
    """Node -> parameters of one shipped file."""
    tree = yaml.safe_load((ROOT / "config/nodes" / name).read_text())
    return {node.removeprefix("/**/"): flat(section["ros__parameters"]) for node, section in tree.items()}


def tables_of(written: Any) -> dict[str, Any]:
    """Node -> what it declares; some nodes have other names than their executables."""
    names = {"recorder_node": "recorder", "ros2_control_driver": "driver", "tracker_driver": "tracker"}
    return {names.get(node, node): table for _, node, table, _ in written.NODES}


def test_shipped_files_are_written_from_the_declarations(written):
    for name, text in written.files().items():
        assert (ROOT / name).read_text() == text, f"{name}: run `python tools/docs/node_parameters.py`"


def test_written_files_name_every_parameter_with_its_default(written):
    tables = tables_of(written)
    for node, values in {**shipped("correction.yaml"), **shipped("rsi.yaml")}.items():
        values.pop("use_sim_time")
        assert values == {p.name: p.default for p in tables[node]}


@pytest.mark.parametrize("file", sorted(p.name for p in (ROOT / "config/nodes").glob("*.yaml")))
def test_every_section_of_a_shipped_file_is_for_a_node_in_any_namespace_and_has_names_that_it_declares(written, file):
    tables = tables_of(written)
    assert all(key.startswith("/**/") for key in yaml.safe_load((ROOT / "config/nodes" / file).read_text()))
    for node, values in shipped(file).items():
        assert set(values) - {"use_sim_time"} <= {p.name for p in tables[node]}


def test_every_number_has_a_range_that_holds_its_default_and_every_parameter_a_text(written):
    for _, node, table, _ in written.NODES:
        for p in table:
            assert p.text, p.name
            if isinstance(p.default, int | float) and not isinstance(p.default, bool) and not p.name.startswith("instruments."):
                in_range = p.low is not None and p.high is not None and p.low <= p.default <= p.high
                assert in_range or p.name in ("truth_seed", "seed"), f"{node}: {p.name}"
