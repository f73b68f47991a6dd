# SPDX-License-Identifier: Apache-2.0
"""A robot and the effects that move its tool: prediction, regressors, model file."""

from .displacements import (
    apply_wrench_effects,
    displacement_of,
    displacements,
    elastic_response,
    mover_of,
    prepared,
    regressors,
    sag_of,
    total_displacement,
    whole_sag_of,
    with_pull,
)
from .model import EIGHTEEN_DOF, GEOMETRIC, MOST_SAG, SIX_DOF, Combination, Envelope, Model
from .term import NO_UNIT, Estimate, Term, axis_compliances, blank_model

__all__ = [
    "EIGHTEEN_DOF",
    "GEOMETRIC",
    "MOST_SAG",
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
    "mover_of",
    "prepared",
    "regressors",
    "sag_of",
    "whole_sag_of",
    "total_displacement",
    "with_pull",
]
