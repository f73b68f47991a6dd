# SPDX-License-Identifier: Apache-2.0
"""What the documents say about the code is true."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from irec_calibration.effects import CATALOGUE

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "irec_calibration/irec_calibration"


def named_in_the_paper_table() -> list[tuple[str, str]]:
    text = (ROOT / "docs/paper-to-code.md").read_text(encoding="utf-8")
    return sorted(set(re.findall(r"`([\w/]+\.py): ([\w.]+)`", text)))


def names_of(path: Path) -> set[str]:
    """Functions, classes and their methods."""
    out = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            out.add(node.name)
        if isinstance(node, ast.ClassDef):
            out |= {f"{node.name}.{n.name}" for n in node.body if isinstance(n, ast.FunctionDef)}
    return out


@pytest.mark.parametrize(("file", "name"), named_in_the_paper_table())
def test_what_the_paper_is_said_to_be_in_exists(file, name):
    assert name in names_of(ROOT / file)


@pytest.mark.parametrize("number", range(1, 21))
def test_every_equation_of_the_paper_has_its_place(number):
    text = (ROOT / "docs/paper-to-code.md").read_text(encoding="utf-8")
    covered = set()
    for first, last in re.findall(r"^\| Eq\. \((\d+)\)(?:-\((\d+)\))?", text, re.M):
        covered |= set(range(int(first), int(last or first) + 1))
    assert number in covered


@pytest.mark.parametrize("document", ["README.md", "CHANGELOG.md"])
def test_the_number_of_effects_is_that_of_the_catalogue(document):
    said = re.findall(r"\[?(\d+) (?:of them\]|physical causes)", (ROOT / document).read_text(encoding="utf-8"))
    assert said == [str(len(CATALOGUE))]


def imports_of(path: Path) -> set[str]:
    """First folder of the package that each relative import goes to."""
    parts = path.relative_to(PACKAGE).parts
    out = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            target = (*parts[: len(parts) - node.level], *(node.module or "").split("."))
            out.add(target[0])
    return out


def test_no_folder_imports_one_that_stands_above_it_in_the_architecture():
    text = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    order = re.findall(r"^\| `(\w+)/` \|", text, re.M)
    there = {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").exists()}
    assert set(order) == there
    upward = {
        f"{path.relative_to(PACKAGE)} imports {room}/"
        for path in PACKAGE.rglob("*.py")
        if path.relative_to(PACKAGE).parts[0] in order
        for room in imports_of(path) & set(order)
        if order.index(room) > order.index(path.relative_to(PACKAGE).parts[0])
    }
    assert upward == set()


def test_each_word_of_the_glossary_is_explained_once():
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \|", (ROOT / "docs/glossary.md").read_text(encoding="utf-8"), re.M)
    words = [w.strip() for row in rows for w in row.split(",") if w.strip() not in ("word", "---")]
    assert len(words) == len(set(words)) > 50


NOT_USED = ("structure without a name", "unnamed", "begun anew", "put_in_words", "AskedInVain", "LAST_WORDS", "FAREWELL")


def test_words_that_the_glossary_replaced_have_not_come_back():
    files = [
        p for d in ("docs", *(d.name for d in ROOT.glob("irec_*"))) for p in (ROOT / d).rglob("*") if p.suffix in (".py", ".md")
    ]
    glossary = ROOT / "docs/glossary.md"
    found = {
        f"{p.relative_to(ROOT)}: {w}" for p in files if p != glossary for w in NOT_USED if w in p.read_text(encoding="utf-8")
    }
    assert found == set() and len(files) > 400


@pytest.mark.parametrize("document", ["architecture", "commissioning", "paper-to-code", "glossary", "adding-an-effect"])
def test_links_of_a_document_lead_somewhere(document):
    path = ROOT / "docs" / f"{document}.md"
    for target in re.findall(r"\]\(([^)#]+)", path.read_text(encoding="utf-8")):
        assert target.startswith("http") or (path.parent / target).exists(), target
