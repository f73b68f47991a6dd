# SPDX-License-Identifier: Apache-2.0
"""KUKA RSI: answering the controller within its cycle."""
