"""The documentation says what the package does: keys and defaults of a study, public names, links that lead somewhere."""

import re
import runpy
import sys
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

import pytest
import yaml
from builders.places import ROOT
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import hsed_jax
from hsed_jax.config.schema import Study
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.discovery.grammar import SHAPES
from hsed_jax.discovery.places import places
from hsed_jax.inference.samplers import SAMPLERS
from hsed_jax.laboratories.kinds import KINDS
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import SLOTS

DOCS = ROOT / "docs"
PAGES = sorted(
    [*DOCS.glob("*.md"), *DOCS.glob("verification/*.md"), *ROOT.glob("*.md"), ROOT / "benchmarks" / "README.md"]
)
# Written in a study without the word `prior`.
WRITTEN = {f"{key}.NAME.prior": f"{key}.NAME.DISTRIBUTION" for key in ("inputs", "model.parameters")}


class Row(NamedTuple):
    default: str
    meaning: str
    change: str


def text_of(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def rows() -> dict[str, Row]:
    """The rows of the page on settings that are about a key: those of four cells."""
    cells = r"\| `([\w.\[\]]+)` " + r"\| ([^|]*) " * 3 + r"\|"
    return {key: Row(*rest) for key, *rest in re.findall(rf"^{cells}$", text_of("settings.md"), re.MULTILINE)}


def sections(annotation: Any, mark: str = "") -> list[tuple[str, type[BaseModel]]]:
    """The sections within an annotation, each with what stands between its key and theirs: `[]` of a list, `.NAME` of names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [(mark, annotation)]
    mark += {list: "[]", dict: ".NAME"}.get(get_origin(annotation), "")  # type: ignore[arg-type]
    return [found for part in get_args(annotation) for found in sections(part, mark)]


def keys(model: type[BaseModel] = Study, path: str = "") -> dict[str, FieldInfo]:
    """Every key of a study that holds a value, by dotted path; per output an error is what it is for all.

    The keys of laboratories are on a page that is written from the code.
    """
    found: dict[str, FieldInfo] = {}
    for name, field in model.model_fields.items():
        here = f"{path}.{field.alias or name}".lstrip(".")
        if path == "experiments" and name in KINDS:
            continue
        inner = sections(field.annotation)
        if any(not mark for mark, _ in inner):
            inner = [(mark, section) for mark, section in inner if mark != ".NAME"]
        if not inner:
            found[WRITTEN.get(here, here)] = field
            continue
        for mark, section in inner:
            found |= keys(section, here + mark)
    return found


def options(annotation: Any) -> list[str]:
    """The words that an annotation allows."""
    if get_origin(annotation) is Literal:
        return [str(option).lower() for option in get_args(annotation)]
    return [option for part in get_args(annotation) for option in options(part)]


def test_the_walk_through_a_study_finds_its_keys():
    found = keys()
    assert {"study", "structure.springs[].stiffness", "error.relative", "design.kriging.trend"} <= set(found)
    assert len(found) > 50


def test_every_key_of_a_study_is_described():
    assert sorted(set(keys()) - set(rows())) == []


def test_every_key_that_is_described_exists():
    parts = {path[: end.start()] for path in keys() for end in re.finditer(r"\[\]|\.", path)}
    assert sorted(set(rows()) - set(keys()) - parts) == []


@pytest.mark.parametrize("key", sorted(set(keys()) & set(rows())))
def test_default_and_options_are_those_of_the_schema(key):
    field, row = keys()[key], rows()[key]
    if field.is_required():
        assert row.default == "required"
    elif field.default is None:
        assert row.default == "none"
    else:
        assert yaml.safe_load(row.default.strip("`")) == field.default
    for option in options(field.annotation):
        assert f"`{option}`" in row.meaning


def test_the_page_of_parts_is_what_the_code_says():
    made = runpy.run_path(str(DOCS / "parts.py"))["page"]()
    assert text_of("parts.md") == made, "run `python docs/parts.py`"


def test_the_page_of_parts_has_every_part_and_every_setting_of_a_laboratory():
    page = text_of("parts.md")
    described = set(re.findall(r"^\| `([\w.]+)` \|", page, re.MULTILINE))
    assert {*KINDS, *ACQUISITIONS, *SAMPLERS} <= described
    settings = {f"experiments.{kind}.{name}" for kind, section in KINDS.items() for name in section.model_fields}
    assert settings <= described


def test_the_places_of_a_discovery_are_those_of_the_code():
    page = text_of("discovery.md")
    rows = re.findall(r"^\| `(\w+)` \|(?: (.*) \| (.*) \| (yes|–) \||.*\|)$", page, re.MULTILINE)
    coordinates = [row for row in rows if row[1]]
    assert tuple(name for name, *rest in rows if not any(rest)) == SLOTS
    known = [(name, c.words, f"${c.symbol}$", "yes" if c.needs_time else "–") for name, c in COORDINATES.items()]
    # What stands between bars would end a cell.
    assert [re.sub(r"\\lvert |\\lvert(?=\\)|\\rvert ?", "|", "\t".join(row)) for row in coordinates] == [
        "\t".join(row) for row in known
    ]
    counts = [len({place[:2] for place in places(slots, has_time=True)}) for slots in (SLOTS, SLOTS[:1])]
    assert f"That is {counts[0]} places of a Bouc–Wen law, {counts[1]} of another." in page


def test_the_grammar_of_a_discovery_is_that_of_the_code():
    (block,) = re.findall(r"```text\n(.*?)```", text_of("discovery.md"), re.DOTALL)
    shapes = [s.text.format(x="x", **{number.symbol: number.symbol for number in s.numbers}) for s in SHAPES]
    assert re.split(r" {2,}|\n", block.strip()) == shapes


def test_how_many_effects_there_are_is_said_once_and_is_what_the_catalogue_has():
    pages = [page for page in PAGES if page.name != "CHANGELOG.md"]  # what there were of them
    said = [(page.name, number) for page in pages for number in re.findall(r"(\d+) physical effects", page.read_text())]
    assert said == [("README.md", str(len(EFFECTS)))]
    # Candidates of a diagnosis are another number: springs of a structure are some, and so is only what the law can have.
    assert not [page.name for page in pages if re.search(rf"\b{len(EFFECTS)} (effects|candidates)", page.read_text())]


def test_every_public_name_is_in_the_reference():
    described = set(re.findall(r"^\.\. auto\w+:: hsed_jax\.(\w+)(?:\(|$)", text_of("api.md"), re.MULTILINE))
    assert sorted(set(dir(hsed_jax)) - described) == []


def test_every_name_in_the_reference_exists():
    for name in re.findall(r"^\.\. auto\w+:: (hsed_jax[\w.]+)", text_of("api.md"), re.MULTILINE):
        module, _, member = name.rpartition(".")
        __import__(module)
        assert hasattr(sys.modules[module], member), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_module_that_is_named_exists(page):
    for path in re.findall(r"`(hsed_jax/[\w/]+\.py)`", page.read_text(encoding="utf-8")):
        assert (ROOT / path).is_file(), path


def slug(heading: str) -> str:
    """The anchor that a code host and the site give to a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def anchors(page: Path) -> set[str]:
    text = page.read_text(encoding="utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {slug(heading) for heading in headings} | set(re.findall(r"^\((\S+)\)=$", text, re.MULTILINE))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    text = re.sub(r"```.*?```|`[^`\n]+`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = page if not file else (page.parent / file).resolve()
        assert there.exists(), f"{page.name} links to {target}"
        if anchor and there.suffix == ".md":
            assert anchor in anchors(there), f"{page.name} links to {target}"


@pytest.fixture
def restructured(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    pytest.importorskip("sphinx")
    from docstrings import restructured

    return restructured


@pytest.mark.parametrize(
    ("markdown", "rest"),
    [
        ("see `hsed check`", "see ``hsed check``"),
        ("the size $\\delta_c$ of it", "the size :math:`\\delta_c` of it"),
        ("$n$th", ":math:`n`\\ th"),
        ("on |t − s| it is `a|b` and $|x|$", "on \\|t − s\\| it is ``a|b`` and :math:`|x|`"),
        ("It is\n\n$$a\n = b$$\n\nhere.", "It is\n\n.. math::\n\n   a\n   = b\n\n\n\nhere."),
    ],
)
def test_docstrings_in_markdown_become_what_sphinx_reads(restructured, markdown, rest):
    assert restructured(markdown) == rest
