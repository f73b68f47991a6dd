# SPDX-License-Identifier: Apache-2.0
"""Who may reach the page: this machine only, or whoever has the token; never a page from elsewhere."""

from __future__ import annotations

import pytest
from irec_calibration.workbench.app import Guard, is_loopback

ON_LOOPBACK, WIDER = Guard(None), Guard(None, "secret")


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
def test_this_machine_is_let_in(host):
    assert ON_LOOPBACK.refusal({"host": host}, "") == ""


def test_a_name_that_somebody_points_at_this_machine_is_refused():
    assert "evil.example" in ON_LOOPBACK.refusal({"host": "evil.example:8765"}, "")


def test_a_page_from_elsewhere_is_refused():
    assert "elsewhere" in ON_LOOPBACK.refusal({"host": "127.0.0.1:8765", "origin": "http://evil.example"}, "")


def test_the_page_itself_may_open_its_websocket():
    assert ON_LOOPBACK.refusal({"host": "127.0.0.1:8765", "origin": "http://127.0.0.1:8765"}, "") == ""


def test_bound_wider_the_token_is_needed():
    assert WIDER.refusal({"host": "cell:8765"}, "") != ""
    assert WIDER.refusal({"host": "cell:8765"}, "token=wrong") != ""


def test_bound_wider_the_token_opens_in_the_address_or_as_a_cookie():
    assert WIDER.refusal({"host": "cell:8765"}, "token=secret") == ""
    assert WIDER.refusal({"host": "cell:8765", "cookie": "irec_token=secret"}, "") == ""


@pytest.mark.parametrize(
    ("host", "yes"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("cell", False)]
)
def test_what_counts_as_this_machine(host, yes):
    assert is_loopback(host) is yes
