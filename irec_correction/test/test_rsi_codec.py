# SPDX-License-Identifier: Apache-2.0
"""RSI packets byte by byte: as the controller's documentation and published examples show them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_correction.errors import ProtocolError
from irec_correction.rsi.codec import abc_of_rotation_vector, decode_robot, encode_reply
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
