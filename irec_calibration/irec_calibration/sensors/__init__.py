# SPDX-License-Identifier: Apache-2.0
"""What other instruments than the tracker tell: tool load from the force sensor, joint stiffness from link encoders."""
