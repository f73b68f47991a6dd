# SPDX-License-Identifier: Apache-2.0
"""Shorthand for types of arrays and of JSON data."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]
Json = dict[str, Any]
