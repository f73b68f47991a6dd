# SPDX-License-Identifier: Apache-2.0
"""From a session to a model: observation, noise, observation system, bounded solution, identifiability, validation."""
