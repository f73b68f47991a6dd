# SPDX-License-Identifier: Apache-2.0
"""Compare a model with a session, see where it fails, learn which effect is missing.

`diagnose(session, model)` gives a `Diagnosis`; `improve(session)` goes on by itself and gives a `Ladder`.
"""

from .attempt import Attempt, added, attempt
from .comparison import compare, compare_observed
from .expected_error import ExpectedError, with_error
from .held_out import Validated, held_out, held_out_beside, solved, validated
from .improve import Ladder, Rung, add_effect, improve, remove_effect, versioned
from .result import Candidate, Comparison, Diagnosis, Measurement, Verdict, View, finite, write_json
from .run import diagnose, start_terms
from .study import Study, prepare

__all__ = [
    "Attempt", "Candidate", "Comparison", "Diagnosis", "ExpectedError", "Ladder", "Measurement", "Rung", "Study", "Validated",
    "Verdict", "View",
    "add_effect", "added", "attempt", "compare", "compare_observed", "diagnose", "finite", "held_out", "held_out_beside",
    "improve", "prepare", "remove_effect", "solved", "start_terms", "validated", "versioned", "with_error", "write_json",
]  # fmt: skip
