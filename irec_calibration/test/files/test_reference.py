# SPDX-License-Identifier: Apache-2.0
"""The pages of docs/formats say what the schemas say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from irec_calibration.files.reference import all_schemas, write

FORMATS = Path(__file__).resolve().parents[3] / "docs" / "formats"


def test_the_pages_are_up_to_date(tmp_path):
    for path in write(tmp_path):
        kept = FORMATS / path.relative_to(tmp_path)
        assert kept.is_file(), f"{kept}: run python -m irec_calibration.files.reference docs/formats"
        assert kept.read_text() == path.read_text(), f"{kept}: run python -m irec_calibration.files.reference docs/formats"


@pytest.mark.parametrize("name", sorted(all_schemas()))
def test_a_page_names_every_key_of_its_format(name):
    text = (FORMATS / f"{name.replace('/', '-')}.md").read_text()
    for key in all_schemas()[name]["properties"]:
        assert f"`{key}`" in text


def test_the_cells_that_we_ship_satisfy_the_schema_that_we_ship():
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((FORMATS / "schemas" / "irec-cell-1.json").read_text())
    for cell in (FORMATS.parents[1] / "config" / "cells").glob("*.yaml"):
        content = yaml.safe_load(cell.read_text())
        if content["format"] == "irec-cell/1":
            jsonschema.validate(content, schema)
