# SPDX-License-Identifier: Apache-2.0
"""Shorthand for arrays of double precision numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Json = dict[str, Any]
