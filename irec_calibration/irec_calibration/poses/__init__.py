# SPDX-License-Identifier: Apache-2.0
"""Where to press: candidate poses on the tooling, selection of few of them, their file."""
