# SPDX-License-Identifier: Apache-2.0
"""Reading files that people and other programs write: regular files of bounded size, YAML without surprises, JSON Schema."""

from ..errors import one_line
from .document import Document, Problem, fail, open_document, read_document
from .outputs import check_no_input, check_replaceable
from .regular import read_bytes, read_text
from .writing import all_or_none, not_written, write_file
from .yaml_text import parse_yaml

__all__ = [
    "Document", "Problem", "all_or_none", "check_no_input", "check_replaceable", "fail", "not_written", "one_line",
    "open_document", "parse_yaml", "read_bytes", "read_document", "read_text", "write_file",
]  # fmt: skip
