# SPDX-License-Identifier: Apache-2.0
"""`irec rsi-config`: the controller's side of the RSI link: ethernet XML and a KRL example."""

from __future__ import annotations

import argparse
import ipaddress
import json
import re
from pathlib import Path

from ..errors import CellError
from ..files import all_or_none, write_file

TIMEOUT_PACKETS = 100
CYCLES = {4: "#IPO_FAST", 12: "#IPO"}


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--address", required=True, help="address of the PC on the robot's network, as in parameter 'address'")
    parser.add_argument("--port", type=int, default=59152, help="UDP port (default: 59152)")
    parser.add_argument("--sentype", default="IREC", help="SENTYPE, as in parameter 'sentype' (default: IREC)")
    parser.add_argument("--cycle-ms", type=int, choices=(4, 12), default=4, help="4: IPO_FAST, 12: IPO")
    parser.add_argument("--limit-mm", type=float, default=3.5, help="of POSCORR, above limit.translation (default: 3.5)")
    parser.add_argument("--limit-deg", type=float, default=0.5, help="of POSCORR, above limit.rotation (default: 0.5)")
    parser.add_argument("-o", "--output", type=Path, default=Path("rsi"), help="folder (default: rsi)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    """0: written."""
    files = make(args.address, args.port, args.sentype, args.cycle_ms, args.limit_mm, args.limit_deg)
    with all_or_none():
        written = [str(write_file(args.output / name, text, error=CellError)) for name, text in files.items()]
    print(json.dumps({"files": written}) if args.json else "\n".join(f"wrote {path}" for path in written))
    return 0


def make(address: str, port: int, sentype: str, cycle_ms: int, limit_mm: float, limit_deg: float) -> dict[str, str]:
    """File name -> content. Raises CellError where a value can't be right."""
    try:
        ip = ipaddress.IPv4Address(address)
    except ValueError:
        raise CellError(f"address '{address}' is not an IPv4 address") from None
    if ip.is_unspecified or ip.is_multicast:
        raise CellError(f"address {address} is not one of a PC; name the one on the robot's network")
    if not 1 <= port <= 65535:
        raise CellError(f"port {port}; 1 .. 65535 is possible")
    if not re.fullmatch(r"[A-Za-z0-9_]{1,20}", sentype):
        raise CellError(f"sentype '{sentype}'; up to 20 letters, digits and _ are possible")
    if not 0.0 < limit_mm <= 20.0 or not 0.0 < limit_deg <= 5.0:
        raise CellError(f"limits of POSCORR {limit_mm} mm, {limit_deg} deg; up to 20 mm and 5 deg are possible")
    values = {
        "address": str(ip), "port": port, "sentype": sentype, "cycle": CYCLES[cycle_ms], "cycle_ms": cycle_ms,
        "timeout": TIMEOUT_PACKETS, "stop_s": TIMEOUT_PACKETS * cycle_ms / 1000, "mm": limit_mm, "deg": limit_deg,
    }  # fmt: skip
    files = {"irec_ethernet.xml": ETHERNET, "irec_example.src": KRL, "README.txt": README}
    return {name: text.format(**values) for name, text in files.items()}


ETHERNET = """<?xml version="1.0" encoding="UTF-8"?>
<!-- Copy to C:/KRC/ROBOTER/Config/User/Common/SensorInterface/ -->
<ROOT>
  <CONFIG>
    <IP_NUMBER>{address}</IP_NUMBER>
    <PORT>{port}</PORT>
    <SENTYPE>{sentype}</SENTYPE>
    <ONLYSEND>FALSE</ONLYSEND>
  </CONFIG>
  <SEND>
    <ELEMENTS>
      <ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL"/>
      <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/>
      <ELEMENT TAG="DEF_EIPos" TYPE="DOUBLE" INDX="INTERNAL"/>
      <ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>
    </ELEMENTS>
  </SEND>
  <RECEIVE>
    <ELEMENTS>
      <!-- HOLDON="1": a late packet keeps the last correction. RKorr is absolute: with 0 the robot would jump back. -->
      <ELEMENT TAG="RKorr.X" TYPE="DOUBLE" INDX="1" HOLDON="1"/>
      <ELEMENT TAG="RKorr.Y" TYPE="DOUBLE" INDX="2" HOLDON="1"/>
      <ELEMENT TAG="RKorr.Z" TYPE="DOUBLE" INDX="3" HOLDON="1"/>
      <ELEMENT TAG="RKorr.A" TYPE="DOUBLE" INDX="4" HOLDON="1"/>
      <ELEMENT TAG="RKorr.B" TYPE="DOUBLE" INDX="5" HOLDON="1"/>
      <ELEMENT TAG="RKorr.C" TYPE="DOUBLE" INDX="6" HOLDON="1"/>
    </ELEMENTS>
  </RECEIVE>
</ROOT>
"""

KRL = """&ACCESS RVP
DEF irec_example()
; Correction of deflection by RSI on top of a programmed path.
; Context irec.rsi (RSIVisual): ETHERNET (irec_ethernet.xml, Timeout {timeout}, Precision 4) -> outputs 1..6 to POSCORR
; (RefCorrSys = ROBROOT, limits +-{mm} mm and +-{deg} deg) -> POSCORRMON with the same limits.
DECL INT ret
DECL INT context

BAS (#INITMOV, 0)
$BASE = $WORLD            ; RIst is reported in $BASE; $WORLD must equal $ROBROOT here
$TOOL = TOOL_DATA[1]      ; the tool0 of the calibration

PTP XHOME

ret = RSI_CREATE("irec.rsi", context, TRUE)
IF (ret <> RSIOK) THEN
  HALT
ENDIF
ret = RSI_ON(#ABSOLUTE, {cycle})   ; absolute corrections, {cycle_ms} ms
IF (ret <> RSIOK) THEN
  HALT
ENDIF

; The programmed path under process forces goes here; RSI adds the correction to it.
; {timeout} late packets in a row ({stop_s} s) stop the robot.

ret = RSI_OFF()           ; only after the PC has faded out: the correction drops to zero here
IF (ret <> RSIOK) THEN
  HALT
ENDIF
PTP XHOME
END
"""

README = """RSI link of irec

1. Copy irec_ethernet.xml into the SensorInterface folder of the controller, irec_example.src into R1/Program.
2. With RSIVisual make a context irec.rsi: ETHERNET object with ConfigFile irec_ethernet.xml, Timeout {timeout}, Precision 4;
   its outputs 1 to 6 into POSCORR with RefCorrSys ROBROOT and limits of {mm} mm and {deg} degrees, watched by POSCORRMON.
3. On the PC: rsi_bridge with address {address}, port {port}, sentype {sentype}, cycle_ms {cycle_ms},
   peer = address of the controller. Its own limits (limit.translation, limit.rotation) must be below those of POSCORR, or
   RSI stops the robot at the first large offset. Start it before the KRL program reaches RSI_ON: a controller that has been
   without answers may hold a correction that nobody here knows, so it gets none until RSI has been started anew.
4. First without force and at reduced speed (T1). This is not a safety function: the limits of the controller stay in charge.
"""
