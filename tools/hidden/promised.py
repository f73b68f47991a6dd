# SPDX-License-Identifier: Apache-2.0
"""How often poses that were planned to tell did tell, by how likely the plan called it.

    python tools/hidden/promised.py NEW ...

Each NEW is a matrix that follow_up.py made, NEW-said what run.py said of it. A question is answered where the two effects are no
longer in one `one_of`; wrong: by a name that was not hidden.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

BINS = ((0.8, 1.01), (0.3, 0.8), (0.0, 0.3))  # chances


def questions_of(new: Path) -> list[tuple[str, float, bool, bool]]:
    """Session, chance, whether it was answered, and whether by a wrong name, of each question about two effects."""
    with open(new.with_name(new.name + "-truth") / "matrix.csv", encoding="utf-8") as f:
        hidden = {r["name"]: (r["effects"] + " " + r["background"]).split() for r in csv.DictReader(f)}
    out = []
    with open(new / "promised.csv", encoding="utf-8") as f:
        for row in csv.DictReader(f):
            pair = row["question"].split("/")
            if len(pair) < 2 or ":" in row["question"]:
                continue
            said = new.with_name(new.name + "-said") / row["name"] / "diagnosis.json"
            verdict = json.loads(said.read_text(encoding="utf-8"))["verdict"]
            open_still = any(set(pair) <= set(several) for several in verdict["one_of"])
            wrong = any(i in pair and i not in hidden[row["name"]] for i in verdict["effects"])
            out.append((f"{new.name}/{row['name']}", float(row["chance"]), not open_still, wrong))
    return out


def main() -> int:
    if len(sys.argv) < 2:
        print(__doc__)
        return 2
    found = [q for new in map(Path, sys.argv[1:]) if (new / "promised.csv").exists() for q in questions_of(new)]
    print(f"{len(found)} questions of {len({q[0] for q in found})} sessions")
    for low, high in BINS:
        mine = [q for q in found if low <= q[1] < high]
        answered, wrong = (sum(q[i] for q in mine) for i in (2, 3))
        promised = f"promised in {100 * low:.0f} to {100 * min(high, 1.0):.0f} of 100 cases"
        print(f"{promised}: {answered} of {len(mine)} answered, {wrong} wrong")
    return 0


if __name__ == "__main__":
    sys.exit(main())
