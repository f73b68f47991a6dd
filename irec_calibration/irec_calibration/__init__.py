# SPDX-License-Identifier: Apache-2.0
"""In-situ elastic calibration of industrial robots: sessions, effects, identification, diagnosis."""

__version__ = "0.1.0"
