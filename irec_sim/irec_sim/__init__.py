# SPDX-License-Identifier: Apache-2.0
"""Stand-in for robot, cell and instruments: elastic plant, contact, servo, force sensor, laser tracker, hidden truths."""

import os

__version__ = "0.1.0"

# As in irec_calibration: on matrices this small, threads of the linear algebra library only wait for each other.
for _library in ("OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
