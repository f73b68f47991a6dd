# SPDX-License-Identifier: Apache-2.0
"""Error type of the simulator."""


class SimError(Exception):
    """Something the user can mend: a file, a value, a command. The message says what, where, and what to do."""
