# SPDX-License-Identifier: Apache-2.0
"""Between the contract of a cell and what other people's drivers speak: joint positions, raw wrenches, tracker streams."""
