# SPDX-License-Identifier: Apache-2.0
"""Streams of trackers: lines and packets in any pieces, what can't be read is said, late bursts get their true stamps back."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.drivers.stamps import Restamper
from irec_calibration.drivers.tracker_stream import EmScon, Lines, StreamError


def packet(points: list[tuple[float, float, float]], seconds: int = 5, micro: int = 250_000, status: int = 0) -> bytes:
    """A continuous measurement as an emScon server sends it."""
    values = b"".join(struct.pack("<iiiddd", 0, seconds, micro + 1000 * k, *p) for k, p in enumerate(points))
    body = struct.pack("<i", status) + struct.pack("<iiiddd", len(points), 2, 0, 20.0, 1013.0, 50.0) + values
    return struct.pack("<ii", 8 + len(body), 3) + body


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_lines_in_any_pieces_give_the_same_points(cuts: list[int]) -> None:
    data = b"".join(f"{k * 0.1:.3f},{1000.5 + k},{-20.25},{3.0}\r\n".encode() for k in range(20))
    lines, out, at = Lines(("time", "x", "y", "z")), [], 0
    for cut in [*cuts, len(data)]:
        out += list(lines.feed(data[at : at + cut]))
        at += cut
    assert len(out) == 20 and lines.bad == 0
    assert out[3].p == pytest.approx((1.0035, -0.02025, 0.003)) and out[3].t == pytest.approx(0.3)


def test_a_line_that_cannot_be_read_is_counted_and_told_and_the_next_one_is_read() -> None:
    lines = Lines(("station", "x", "y", "z"), "m")
    out = list(lines.feed(b"# header\nA 1 2\nA one 2 3\nA nan 2 3\nA;1;2;3;extra\nA 0 0 0\n"))
    assert [(r.station, r.p) for r in out] == [("A", (1.0, 2.0, 3.0))]
    assert lines.bad == 3 and "no finite numbers" in lines.last_bad


def test_bytes_without_an_end_of_line_do_not_fill_the_memory() -> None:
    lines = Lines()
    for _ in range(100):
        assert not list(lines.feed(b"\xff" * 1000))
    assert len(lines._rest) <= 4096 and "without an end of line" in lines.last_bad


@pytest.mark.parametrize(
    "settings", [{"columns": ("x", "y")}, {"columns": ("x", "y", "z", "q")}, {"unit": "cm"}, {"time_unit": "h"}]
)
def test_columns_and_units_that_cannot_be_meant_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(StreamError):
        Lines(**settings)  # type: ignore[arg-type]


@given(st.lists(st.integers(1, 60), min_size=1, max_size=30))
def test_packets_in_any_pieces_give_the_same_points(cuts: list[int]) -> None:
    other = struct.pack("<ii", 16, 8) + bytes(8)  # a change of the system status
    data = packet([(1500.0, 200.0, -30.0), (1501.0, 200.0, -30.0)]) + other + packet([(0.0, 0.0, 0.0), (1502.0, 0.0, 0.0)], 6)
    stream, out, at = EmScon(), [], 0
    for cut in [*cuts, len(data)]:
        out += list(stream.feed(data[at : at + cut]))
        at += cut
    assert [r.p for r in out] == [pytest.approx(p) for p in [(1.5, 0.2, -0.03), (1.501, 0.2, -0.03), (1.502, 0.0, 0.0)]]
    assert [r.t for r in out] == pytest.approx([5.25, 5.251, 6.251])


def test_a_result_with_an_error_gives_no_point() -> None:
    stream = EmScon()
    assert not list(stream.feed(packet([(1.0, 2.0, 3.0)], status=4))) and "status 4" in stream.last_bad


def test_bytes_that_are_no_packets_are_refused() -> None:
    with pytest.raises(StreamError, match="no emScon stream"):
        list(EmScon().feed(b"1500.0,200.0,-30.0\r\n"))


@given(st.binary(max_size=300))
def test_any_bytes_end_in_points_or_a_refusal(data: bytes) -> None:
    for stream in (Lines(), EmScon()):
        try:
            list(stream.feed(data))
        except StreamError:
            pass


def bursts(rate: float, seconds: float, drift: float = 0.0, least: float = 0.003, seed: int = 1) -> tuple[np.ndarray, ...]:
    """Taken at, on the tracker's clock, arrived at: held up for up to 0.3 s and then sent together."""
    rng = np.random.default_rng(seed)
    taken = 100.0 + np.arange(int(rate * seconds)) / rate
    own = (taken - 93.0) * (1.0 + drift)
    arrived, free = np.empty_like(taken), 0.0
    for k, t in enumerate(taken):
        if t > free and rng.random() < 0.02:
            free = t + rng.uniform(0.05, 0.3)  # the link sleeps
        arrived[k] = max(t, free) + least + rng.exponential(2e-4)
    return taken, own, np.maximum.accumulate(arrived)


def test_bursts_of_a_stream_with_a_clock_get_the_time_at_which_they_were_taken() -> None:
    taken, own, arrived = bursts(100.0, 60.0, drift=2e-5)
    restamp = Restamper(delay=0.003)
    stamps = np.array([restamp.stamp(a, t) for a, t in zip(arrived, own, strict=True)], dtype=float)
    late = arrived - taken
    assert late.max() > 0.25, "the stream is as bad as it is said to be"
    assert np.nanmax(np.abs(stamps - taken)[500:]) < 1e-3
    assert "largest" in restamp.lateness_text() and 1e6 * restamp.drift == pytest.approx(20.0, abs=15.0)


def test_bursts_of_a_stream_without_a_clock_are_counted_out() -> None:
    taken, _, arrived = bursts(10.0, 60.0)
    restamp = Restamper(period=0.1, delay=0.003)
    stamps = np.array([restamp.stamp(a, None) for a in arrived], dtype=float)
    assert np.nanmax(np.abs(stamps - taken)[100:]) < 5e-3


def test_a_broken_beam_begins_the_count_anew() -> None:
    restamp = Restamper(period=0.1)
    first = [restamp.stamp(10.0 + 0.1 * k, None) for k in range(20)]
    after = restamp.stamp(20.0, None)
    assert first[-1] == pytest.approx(11.9) and after == pytest.approx(20.0)


def test_a_reading_that_is_not_newer_is_left_out() -> None:
    restamp = Restamper()
    assert restamp.stamp(10.0, 1.0) == pytest.approx(10.0)
    assert restamp.stamp(10.1, 1.0) is None


def test_a_tracker_whose_clock_is_set_back_goes_on() -> None:
    restamp = Restamper()
    restamp.stamp(10.0, 5000.0)
    assert restamp.stamp(10.1, 3.0) == pytest.approx(10.1)
