# SPDX-License-Identifier: Apache-2.0
"""Real-time correction of robot deflection under process forces: wrench conditioning, offsets, limits, RSI and CAN."""

__version__ = "0.1.0"
