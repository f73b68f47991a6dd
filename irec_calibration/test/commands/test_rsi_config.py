# SPDX-License-Identifier: Apache-2.0
"""Files for the controller."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from irec_calibration.cli import main
from irec_calibration.commands.rsi_config import make
from irec_calibration.errors import CellError


def test_ethernet_xml_names_the_pc_and_holds_absolute_corrections(tmp_path):
    assert main(["rsi-config", "--address", "192.168.1.10", "--port", "59153", "-o", str(tmp_path)]) == 0
    root = ElementTree.parse(tmp_path / "irec_ethernet.xml").getroot()
    assert root.findtext("CONFIG/IP_NUMBER") == "192.168.1.10"
    assert root.findtext("CONFIG/PORT") == "59153"
    assert root.findtext("CONFIG/SENTYPE") == "IREC"
    sent = {e.get("TAG") for e in root.findall("SEND/ELEMENTS/ELEMENT")}
    assert {"DEF_RIst", "DEF_AIPos", "DEF_Delay"} <= sent
    received = {e.get("TAG"): e.get("HOLDON") for e in root.findall("RECEIVE/ELEMENTS/ELEMENT")}
    assert received == {f"RKorr.{a}": "1" for a in "XYZABC"}


@pytest.mark.parametrize(("cycle", "word"), [(4, "#IPO_FAST"), (12, "#IPO)")])
def test_krl_example_asks_for_absolute_corrections_in_the_cycle_given(cycle, word):
    text = make("192.168.1.10", 59152, "IREC", cycle, 3.5, 0.5)["irec_example.src"]
    assert "#ABSOLUTE" in text and word in text


@pytest.mark.parametrize("bad", [
    {"address": "robot"}, {"address": "0.0.0.0"}, {"port": 0}, {"sentype": "a b"}, {"limit_mm": 50.0}, {"limit_deg": 0.0},
])  # fmt: skip
def test_values_that_can_not_be_right_are_refused(bad):
    values = {"address": "192.168.1.10", "port": 59152, "sentype": "IREC", "cycle_ms": 4, "limit_mm": 3.5, "limit_deg": 0.5}
    with pytest.raises(CellError):
        make(**{**values, **bad})
