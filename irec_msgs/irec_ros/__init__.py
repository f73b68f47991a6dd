# SPDX-License-Identifier: Apache-2.0
"""What the nodes of all packages share: start, parameters, guarded callbacks, diagnostics, exact serialization."""
