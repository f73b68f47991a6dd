# SPDX-License-Identifier: Apache-2.0
"""Recertification: is the calibration in force still right, a new one where it is not, and the record of all of them."""
