"""What a new part touches: each row of the table in `docs/design.md`, tried in a copy of the package.

A part that is one file is that file (`tests/parts`); other parts are the entries that the table names.  The copy runs in a
process of its own (`tests/parts/tried.py`).
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from builders.places import ROOT

# The copy of the package compiles all that it tries anew.
pytestmark = pytest.mark.whole

PARTS = ROOT / "tests" / "parts"
TABLE = (ROOT / "docs" / "design.md").read_text(encoding="utf-8").split("## What a new part touches")[1]
ROWS = {row[0]: row[1] for row in re.findall(r"^\| ([^|`]+?) \| (.+) \|$", TABLE, re.MULTILINE) if row[0] != "part"}

# By row of the table, the files that are added, and in files that exist what is put before which text.
FILES = {
    "spring law": {"physics/laws/doubled.py": "doubled.py"},
    "acquisition": {"design/acquisitions/middle.py": "middle.py"},
    "sampler": {"inference/samplers/renamed.py": "renamed.py"},
    "laboratory": {"laboratories/kinds/bench.py": "bench.py"},
    "excitation": {"physics/excitations/repeated.py": "repeated.py"},
    "material of OpenSees": {"models/opensees/elastic_pp.py": "elastic_pp.py"},
}
ENTRIES = {
    "material of OpenSees": [
        (
            "models/opensees/__init__.py",
            "\n_ALL = ",
            "from hsed_jax.models.opensees.elastic_pp import ElasticPP\n",
        ),
        ("models/opensees/__init__.py", "Pinching4, IMKPeakOriented", "ElasticPP, "),
    ],
    "excitation": [
        (
            "physics/declared.py",
            "DECLARED = {",
            'REPEATED = Declared("repeated", GROUND_MOTION, {}, lambda settings, duration: "Shaken twice as much", '
            'of_file=("time", "ground_acceleration"))\n',
        ),
    ],
    "effect": [
        (
            "physics/effects/elastic.py",
            "@register\n@final\nclass CubicStiffness",
            "@register\n@final\nclass Steadfast(AbstractSpringEffect):\n"
            '    """A force that is proportional to the elongation."""\n\n'
            '    name: ClassVar[str] = "steadfast"\n    family: ClassVar[str] = "elastic"\n'
            '    reference: ClassVar[str] = "a test"\n\n'
            '    delta: Scalar = parameter("d", "1", "its size", neutral=0.0, prior={"normal": [0.0, 0.3]})\n\n'
            "    def contribute(self, point):\n"
            '        """An addend to `force`."""\n'
            '        return {"force": self.delta * point.scales.force * point.elongation / point.scales.elongation}\n\n\n',
        )
    ],
    "form of an effect": [
        (
            "physics/effects/elastic.py",
            '        Form("power", r"\\delta F_c|\\Delta u/u_c|^p\\,',
            '        Form("fifth", r"\\delta F_c(\\Delta u/u_c)^5", held={"power": 5.0}),\n',
        )
    ],
    "coordinate of a [learned function](discovery.md)": [
        (
            "physics/effects/coordinates.py",
            '    "rate": Coordinate(',
            '    "halved": Coordinate("half of the elongation", "u/2u_c", "u/2u_c", "m", lambda s: s.elongation, '
            "lambda p: 0.5 * p.elongation / p.scales.elongation),\n",
        ),
        (
            "discovery/places.py",
            '    if name == "energy":',
            '    if name == "halved":\n        return 0.5 * u / scales.elongation\n',
        ),
    ],
    "shape of a learned formula": [
        ("discovery/grammar.py", ')  # fmt: skip\n"""The simplest first', '    Shape("{x} ** 4", "{x}^4", "{x}^4"),\n')
    ],
    "quantity": [
        (
            "physics/outputs.py",
            '    "peak_elongation": ',
            '    "peak_rate": Quantity("v", "m/s", "largest rate", channels=lambda masses: ("elongation_rate",), '
            'measured=lambda time, channels: float(np.max(np.abs(channels["elongation_rate"]))), '
            "kept=_largest(lambda step: step.system.kinematics(*step.end)[step.specimen][1])),\n",
        )
    ],
    "conjugate pair": [
        (
            "physics/pairs.py",
            '    Pair("shear angle"',
            '    Pair("curvature", "moment", "1/m", "N*m", "J/m", r"\\kappa", r"\\dot\\kappa", "M"),\n',
        ),
        (
            "measurements/units.py",
            '    Dimension("moment"',
            '    Dimension("curvature", "1/m", "1/m"), Dimension("rate of curvature", "1/(m*s)", "1/m/s"),\n',
        ),
    ],
}


@pytest.fixture(scope="module")
def tried(tmp_path_factory):
    """What came of all new parts, in a copy of the package that has them."""
    place = tmp_path_factory.mktemp("copy")
    package = place / "hsed_jax"
    shutil.copytree(ROOT / "hsed_jax", package, ignore=shutil.ignore_patterns("__pycache__"))
    for files in FILES.values():
        for target, source in files.items():
            shutil.copy(PARTS / source, package / target)
    for entries in ENTRIES.values():
        for target, before, text in entries:
            content = (package / target).read_text(encoding="utf-8")
            assert content.count(before) == 1, f"{target} has no single {before!r}"
            (package / target).write_text(content.replace(before, text + before), encoding="utf-8")
    shutil.copy(PARTS / "tried.py", place)
    shutil.copy(PARTS / "study.yaml", place)
    shutil.copy(ROOT / "docs" / "parts.py", place / "docs_parts.py")
    environment = os.environ | {"PYTHONPATH": str(place), "JAX_COMPILATION_CACHE_DIR": str(place / "cache")}
    done = subprocess.run(
        [sys.executable, place / "tried.py", place / "run"], capture_output=True, text=True, cwd=place, env=environment
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert Path(found["package"]).is_relative_to(place)
    return found


def test_every_row_of_the_table_is_tried():
    assert set(ROWS) == {*FILES, *ENTRIES}


@pytest.mark.parametrize("row", ROWS)
def test_a_row_names_the_files_that_the_part_touches(row):
    named = set(re.findall(r"`((?:\w+/)+\w+(?:\.py)?)`", ROWS[row]))
    touched = {*FILES.get(row, {}), *(target for target, _, _ in ENTRIES.get(row, []))}
    # A folder stands for a new file in it, or for one of its files.
    assert {name for name in named if (ROOT / "hsed_jax" / name).exists()} == named
    assert all(any(file == name or file.startswith(f"{name}/") for name in named) for file in touched)
    assert all(any(file == name or file.startswith(f"{name}/") for file in touched) for name in named)


def test_a_law_is_one_file(tried):
    # The peak force is 2k times the elongation, and the bench has 6e5 N/m.
    assert tried["run"]["k"] == pytest.approx(3.0e5, rel=1e-3)
    assert "there is no spring law 'double' (did you mean doubled?)" in tried["run"]["messages"][4]


def test_a_laboratory_is_one_file(tried):
    negative, unknown, *_ = tried["run"]["messages"]
    assert "experiments.bench.stiffness" in negative and "greater than 0" in negative
    assert "experiments.bensh: there is no such key (did you mean bench?)" in unknown
    assert "a spring on a bench" in tried["run"]["title"]
    assert "performed by a bench" in tried["run"]["report"]
    assert (
        "| `experiments.bench.stiffness` | required | Stiffness of the spring on the bench [N/m] |"
        in tried["run"]["page"]
    )


def test_an_acquisition_is_one_file(tried):
    # 64 points of a Sobol' sequence fill the interval to 1/64.
    assert tried["run"]["chosen"] == [pytest.approx(0.5, abs=1 / 64)]
    assert "there is no acquisition 'midle' (did you mean middle?)" in tried["run"]["messages"][2]
    assert "| `middle` | Next to the middle of the inputs | a test |" in tried["run"]["page"]


def test_a_sampler_is_one_file(tried):
    assert tried["run"]["sampler"] == "renamed"
    assert "draws of the renamed sampler" in tried["run"]["printed"]
    assert "there is no sampler 'rename' (did you mean renamed?)" in tried["run"]["messages"][3]
    assert "| `renamed` | The Gaussian at the mode, under another name | a test |" in tried["run"]["page"]


def test_an_excitation_is_its_declaration_and_its_class(tried):
    repeated, recorded = tried["excitation"]
    assert repeated == pytest.approx(recorded, rel=1e-12) and recorded > 0


def test_an_effect_is_one_class(tried):
    # 2e6 N/m and 1 kN over 10 mm, at 20 mm.
    assert tried["effect"] == pytest.approx(2.0e6 * 0.02 + 1e3 * 2, rel=1e-6)


def test_a_form_is_one_entry(tried):
    assert tried["form"] == pytest.approx(2.0e6 * 0.02 + 1e3 * 2**5, rel=1e-6)


def test_a_quantity_is_one_entry(tried):
    quantity, history = tried["quantity"]
    assert quantity == pytest.approx(history, rel=1e-12) and quantity > 0


def test_a_pair_is_an_entry_and_its_new_dimensions(tried):
    assert tried["pair"] == "curvature"


def test_a_material_is_one_file_and_its_name(openseespy, tried):
    # Twice its yield elongation at 2e6 N/m and 1 kN.
    assert tried["material"] == pytest.approx([1.0e3, 1.0e3])


def test_a_coordinate_is_two_entries(tried):
    assert tried["coordinate"]["values"] == pytest.approx([0.0, 0.5, 1.0])
    assert tried["coordinate"]["places"] > 0 and tried["coordinate"]["words"] == "half of the elongation"


def test_a_shape_is_one_entry(tried):
    assert tried["shape"] == [16.0]
