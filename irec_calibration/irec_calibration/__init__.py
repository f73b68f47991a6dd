# SPDX-License-Identifier: Apache-2.0
"""In-situ elastic calibration of industrial robots: sessions, effects, identification, diagnosis."""

import os

__version__ = "0.1.0"

# The matrices here are small: threads of the linear algebra library wait for each other on them, on a busy machine for five times
# as long as one thread computes. It reads this when numpy is loaded, so nothing may import numpy before; who sets it decides.
for _library in ("OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
