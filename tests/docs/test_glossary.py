"""The glossary: one meaning a word, each word used, each name in the code; words that are not used are not used."""

import importlib
import re
from pathlib import Path

import pytest
from builders.places import ROOT

import hsed_jax

DOCS = ROOT / "docs"
GLOSSARY = (DOCS / "glossary.md").read_text(encoding="utf-8")
# What a user reads, without the history of changes.
PAGES = [*sorted(DOCS.glob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "benchmarks" / "README.md"]
TERMS = re.findall(r"^\| \*\*([^*]+)\*\* \| ([^|]+) \| `([^`]+)` \|$", GLOSSARY, re.MULTILINE)
UNUSED = [
    phrase.strip()
    for row in re.findall(r"^\| ([^|*]+) \| [^|]+ \|$", GLOSSARY.split("## Words that are not used")[1], re.MULTILINE)[
        2:
    ]
    for phrase in row.split(",")
]


def prose_of(page: Path) -> str:
    """The running text of a page in one line: without code, formulas, links' targets and the rows of tables that hold output."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"```.*?```|<!--.*?-->|\$\$.*?\$\$", " ", text, flags=re.DOTALL)
    text = re.sub(r"`[^`\n]*`|\$[^$\n]*\$|\]\([^)]*\)", " ", text)
    return " ".join(text.split()).lower()


PROSE = {page.name if page.parent == DOCS else str(page.relative_to(ROOT)): prose_of(page) for page in PAGES}


def test_the_tables_are_read():
    assert len(TERMS) > 40 and len(UNUSED) >= 5
    # No row of a table of terms is left out by the pattern.
    assert len(TERMS) == len(re.findall(r"^\| \*\*", GLOSSARY, re.MULTILINE))


def test_no_term_is_defined_twice_and_none_by_the_words_of_another():
    terms = [term.lower() for term, _, _ in TERMS]
    meanings = [meaning.lower() for _, meaning, _ in TERMS]
    assert sorted(set(terms)) == sorted(terms) and len(set(meanings)) == len(meanings)


@pytest.mark.parametrize("term", [term for term, _, _ in TERMS])
def test_a_term_is_used_outside_the_glossary(term):
    pattern = re.compile(rf"\b{re.escape(term.lower())}(s|es)?\b")
    assert any(pattern.search(prose) for name, prose in PROSE.items() if name != "glossary.md")


@pytest.mark.parametrize("name", sorted({name for _, _, name in TERMS}))
def test_the_name_of_a_term_exists(name):
    if not name.startswith("hsed_jax"):
        reference = "".join(
            (DOCS / page).read_text(encoding="utf-8") for page in ("settings.md", "results.md", "measurements.md")
        )
        assert re.search(rf"(?<![\w]){re.escape(name.split(':')[0])}\b", reference)
        return
    found = hsed_jax
    for part in name.split(".")[1:]:
        # The function of this name, and not the module: to import that would hide it.
        found = getattr(found, part) if hasattr(found, part) else importlib.import_module(f"{found.__name__}.{part}")


@pytest.mark.parametrize("phrase", UNUSED)
def test_a_word_that_is_not_used_is_not_used(phrase):
    pattern = re.compile(rf"\b{re.escape(phrase.lower())}s?\b")
    found = {
        name: prose[max(0, match.start() - 40) : match.end() + 20]
        for name, prose in PROSE.items()
        if name != "glossary.md" and (match := pattern.search(prose))
    }
    assert found == {}
