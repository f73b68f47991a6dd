# SPDX-License-Identifier: Apache-2.0
"""Compare a model with a session, see where it fails, learn which effect is missing.

`diagnose(session, model)` gives a `Diagnosis`; `improve(session)` goes on by itself and gives a `Ladder`.
"""

from .comparison import compare
from .improve import Ladder, Rung, add_effect, improve, remove_effect
from .result import Candidate, Comparison, Diagnosis, Measurement, Verdict, View, finite, write_json
from .run import diagnose, start_terms

__all__ = [
    "Candidate", "Comparison", "Diagnosis", "Ladder", "Measurement", "Rung", "Verdict", "View",
    "add_effect", "compare", "diagnose", "finite", "improve", "remove_effect", "start_terms", "write_json",
]  # fmt: skip
