# SPDX-License-Identifier: Apache-2.0
"""Force sensors on CAN."""
