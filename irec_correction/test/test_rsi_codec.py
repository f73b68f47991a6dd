# SPDX-License-Identifier: Apache-2.0
"""RSI packets byte by byte: as the controller's documentation and published examples show them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.errors import ProtocolError
from irec_correction.rsi.codec import abc_of_rotation_vector, decode_robot, encode_reply, stamp_of
from scipy.spatial.transform import Rotation

FROM_CONTROLLER = (
    b'<Rob Type="KUKA"><RIst X="1620.0002" Y="-12.5000" Z="1910.0" A="180.0" B="0.0" C="-90.0"/>'
    b'<RSol X="1620.0" Y="-12.5" Z="1910.0" A="180.0" B="0.0" C="-90.0"/>'
    b'<AIPos A1="0.0" A2="-90.0" A3="90.0" A4="1.5" A5="45.0" A6="-180.0"/>'
    b'<ASPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="45.0" A6="0.0"/>'
    b'<EIPos E1="1250.0" E2="0.0" E3="0.0" E4="0.0" E5="0.0" E6="0.0"/>'
    b'<Delay D="3"/><IPOC>4208163641</IPOC></Rob>'
)


def test_packet_of_the_controller_is_read_in_metres_and_radians():
    packet = decode_robot(FROM_CONTROLLER)
    assert packet.ipoc == 4208163641
    assert packet.late == 3
    np.testing.assert_allclose(packet.p_tcp, [1.6200002, -0.0125, 1.91])
    np.testing.assert_allclose(packet.q, np.radians([0, -90, 90, 1.5, 45, -180]))
    np.testing.assert_allclose(packet.abc, np.radians([180, 0, -90]))
    assert packet.external[0] == pytest.approx(1.25)


def test_answer_is_these_bytes():
    reply = encode_reply(np.array([0.00123456, -0.0005, 0.0]), np.array([0.0, 0.0, np.radians(0.25)]), 4208163641, "IREC")
    assert reply == (
        b'<Sen Type="IREC"><RKorr X="1.2346" Y="-0.5000" Z="0.0000" A="0.2500" B="0.0000" C="0.0000"/>'
        b"<IPOC>4208163641</IPOC></Sen>"
    )


@pytest.mark.parametrize("missing", [b"RIst", b"AIPos", b"IPOC"])
def test_packet_without_what_is_needed_is_refused_by_name(missing):
    with pytest.raises(ProtocolError, match=missing.decode()):
        decode_robot(FROM_CONTROLLER.replace(missing, b"Other"))


def test_packet_without_external_axes_and_delay_is_read():
    packet = decode_robot(FROM_CONTROLLER.replace(b"EIPos", b"X1").replace(b"Delay", b"X2"))
    assert not np.any(packet.external) and packet.late == 0


@given(st.binary(max_size=300))
def test_no_bytes_whatever_raise_anything_but_a_protocol_error(data):
    with pytest.raises(ProtocolError):
        decode_robot(data)


@given(st.tuples(*(st.floats(-1.5, 1.5) for _ in range(3))))
def test_abc_is_the_rotation_about_z_then_y_then_x(v):
    rotation = Rotation.from_rotvec(v)
    again = Rotation.from_euler("ZYX", abc_of_rotation_vector(np.array(v)))
    assert (rotation.inv() * again).magnitude() < 1e-6


@pytest.mark.parametrize("digits", [16, 320, 3000])
def test_an_ipoc_of_too_many_digits_is_no_ipoc(digits):
    packet = FROM_CONTROLLER.replace(b"4208163641", b"4" * digits)
    assert stamp_of(packet) is None
    with pytest.raises(ProtocolError, match="IPOC"):
        decode_robot(packet)


def test_a_delay_of_too_many_digits_counts_as_not_sent():
    assert stamp_of(FROM_CONTROLLER.replace(b'D="3"', b'D="' + b"3" * 320 + b'"')) == (4208163641, None)


fragments = st.sampled_from(
    [b"", b"<", b'"', b"/>", b"9" * 400, b"-", b"e9999", b"nan", b"inf", b"\0", b"\xff", b"<IPOC>", b"</IPOC>", b"."]
)


@settings(max_examples=300)
@given(st.lists(st.tuples(st.integers(0, len(FROM_CONTROLLER)), st.integers(0, 20), fragments), min_size=1, max_size=4))
def test_a_packet_with_parts_replaced_is_read_as_finite_numbers_or_refused(changes):
    packet = FROM_CONTROLLER
    for at, length, new in changes:
        packet = packet[:at] + new + packet[at + length :]
    stamp_of(packet)
    try:
        read = decode_robot(packet)
    except ProtocolError:
        return
    assert all(np.all(np.isfinite(v)) for v in (read.q, read.p_tcp, read.abc, read.external))
