# SPDX-License-Identifier: Apache-2.0
"""Production on a hard plant: whole parts driven faster than real time, with the arm's dynamics, the correction's channel and the
process. Knows nothing of the correction itself: what answers a wrench with an offset comes from outside (`runner.Controller`)."""
