# SPDX-License-Identifier: Apache-2.0
"""Error type of the simulator."""


class SimError(Exception):
    """Something the user can mend: a file, a value, a command. The message says what, where, and what to do."""

    def __init__(self, message: object = "") -> None:
        text = str(message)  # one line, whatever the file that it quotes holds
        super().__init__(text if text.isprintable() else "".join(c if c.isprintable() else " " for c in " ".join(text.split())))
