# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `irec`: each module has `configure(parser)` and `run(args) -> exit code`."""
