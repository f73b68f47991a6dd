# SPDX-License-Identifier: Apache-2.0
"""Real-time correction of robot deflection under process forces: wrench conditioning, offsets, limits, RSI and CAN."""

import irec_calibration  # noqa: F401  before numpy: it sets with how many threads that computes

__version__ = "0.1.0"
