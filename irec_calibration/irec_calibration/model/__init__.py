# SPDX-License-Identifier: Apache-2.0
"""A robot and the effects that move its tool: prediction, regressors, model file."""

from .model import (
    EIGHTEEN_DOF,
    GEOMETRIC,
    NO_UNIT,
    SIX_DOF,
    Combination,
    Envelope,
    Estimate,
    Model,
    Term,
    apply_wrench_effects,
    axis_compliances,
    blank_model,
    displacement_of,
    displacements,
    elastic_response,
    prepared,
    regressors,
    total_displacement,
)

__all__ = [
    "EIGHTEEN_DOF",
    "GEOMETRIC",
    "NO_UNIT",
    "SIX_DOF",
    "Combination",
    "Envelope",
    "Estimate",
    "Model",
    "Term",
    "apply_wrench_effects",
    "axis_compliances",
    "blank_model",
    "displacement_of",
    "displacements",
    "elastic_response",
    "prepared",
    "regressors",
    "total_displacement",
]
