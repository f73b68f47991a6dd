# SPDX-License-Identifier: Apache-2.0
"""Thin shells that carry messages in and out."""
