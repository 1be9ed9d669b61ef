"""Results show themselves: a sentence and a short table, the same as text and as HTML, whatever the names in them."""

import io
import re
import subprocess
import sys
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.calibrations import STUDY, calibration, fitted, improvement
from builders.diagnoses import candidate, diagnosis
from builders.misfits import histories, quantities

import hsed_jax as hx
from hsed_jax.command_line import _tell as tell
from hsed_jax.criticism.improve import Step, Trail
from hsed_jax.criticism.prediction import error_change
from hsed_jax.inference.nuts import Convergence
from hsed_jax.measurements import Record
from hsed_jax.physics.response import Response
from hsed_jax.tables import MOST, Table, Tabular, cell

EVIL = "<script>alert('1')</script> & \"$x$\""


def response(size=()):
    histories = np.linspace(-2.0, 1.0, 12).reshape(*([1] * len(size)), 12) * np.ones((*size, 1))
    return Response(
        {"peak_force": jnp.full(size, 2.0)}, {"elongation": jnp.asarray(histories)}, jnp.ones(size, dtype=bool)
    )


SHOWN = {
    "fit": fitted,
    "calibration": lambda: calibration(histories()),
    "comparison": lambda: histories(2, 1)[1],
    "comparison of quantities": lambda: quantities()[1],
    "location": lambda: histories(2, 1)[2],
    "diagnosis": lambda: diagnosis([candidate("gap", 9.0, 0.9)], ["gap"]),
    "nothing to diagnose": lambda: diagnosis([]),
    "trail": lambda: improvement().trail,
    "improvement": improvement,
    "campaign": lambda: quantities(20, 5)[0],
    "study": lambda: STUDY,
    "response": response,
    "responses": lambda: response((4,)),
}


def words(text):
    return " ".join(text.split())


@pytest.mark.parametrize("name", SHOWN)
def test_text_and_html_say_the_same_and_are_short(name):
    shown = SHOWN[name]()
    text, html = repr(shown), shown._repr_html_()
    table = shown._table()
    assert text == str(shown)
    assert text.startswith(table.sentence) and len(text.splitlines()) <= MOST + 8
    bare = words(unescape(re.sub(r"<[^>]+>", " ", html)))
    for row in table.rows[:MOST]:
        assert words(" ".join(row)) in bare and words(" ".join(row)) in words(text)
    assert html.count("<tr>") == min(len(table.rows), MOST) + bool(table.heads and table.rows)
    assert "nan" not in text and "array(" not in text and max(map(len, text.splitlines())) < 240
    assert not re.search(r"(?<!-)color|background|#[0-9a-f]{3,6}\b", html)  # a dark notebook has colours of its own


def test_the_numbers_are_those_of_the_results():
    comparison = histories(2, 1)[1]
    text = repr(comparison)
    assert text.splitlines()[0] == comparison.verdict
    for split in (comparison.train, comparison.test):
        assert f"{split.error:.3f}" in text
        assert all(f"{values['nrmse']:.3f}" in text for values in split.per_output.values())
    fit = fitted()
    row = next(line for line in repr(fit).splitlines() if line.startswith("beta"))
    s = fit.summary()["beta"]
    assert row.split() == [
        "beta",
        "[1/m]",
        *(f"{v:.4g}" for v in (1.0, s["mean"], s["sd"], s["q05"], s["q95"])),
        "900",
        "1.000",
    ]
    better = improvement()
    assert (
        repr(better).splitlines()[0]
        == "the error on experiments that were not fitted goes from 0.400 to 0.200 (noise 0.050)"
    )
    assert better.after.verdict in repr(better)
    assert error_change("0.029", "0.029") == "stays at 0.029"


def test_the_sentence_of_what_is_wrong_comes_first():
    fit = fitted()
    assert repr(fit).startswith("calibrated on 3 experiments; converged, no divergences")
    fit = replace(fit, convergence=fit.convergence._replace(divergences=7))
    assert re.match("calibrated on 3 experiments; warning: .*7 .*diverg", repr(fit))
    assert "warning" in fit._repr_html_().split("<table>")[0]


def test_a_spring_that_softens_is_called_so():
    steps = [Step([], 0.3, 0.4, {}), Step(["hardening"], 0.1, 0.2, {"hardening.delta": -0.25})]
    assert "+ hardening (softening, as by P-Delta)" in repr(Trail(steps, 0.05))


def test_a_response_shows_its_peaks_and_what_diverged():
    assert re.search(r"elongation +12 samples +2 +m", repr(response()))
    batch = response((4,))._replace(ok=jnp.asarray([True, True, False, True]))
    assert repr(batch).startswith("response of 4 experiments; 1 diverged and have no meaning")


def test_a_response_shows_itself_inside_a_transformation_too():
    seen = []

    @jax.jit
    def look(response):
        seen.append(repr(response))
        return response.ok

    look(response())
    assert seen[0].startswith("Response(") and "Trace" in seen[0]
    assert repr(Response({"peak_force": 0}, {}, None)) == "Response({'peak_force': 0}, {}, None)"


def test_hostile_names_stay_names():
    campaign = histories(1, 0, id="<b onclick=x>$x$ & {}")[0]
    for shown in (campaign, diagnosis([candidate(EVIL, 1.0)]), Table(EVIL, (EVIL,), [(EVIL,)], [EVIL])):
        html = shown.html() if isinstance(shown, Table) else shown._repr_html_()
        assert not re.search("<script|<b ", html) and re.search("&lt;script&gt;|&lt;b onclick=x&gt;", html)
        assert html.count("<") == html.count(">")
        assert 'class="tex2jax_ignore mathjax_ignore"' in html  # the dollars


def test_more_rows_than_fit_are_counted():
    table = Table("so", ("a", "b"), [(f"row {i}", f"{i}") for i in range(20)], ["note"])
    for text in (str(table), table.html()):
        assert "row 11" in text and "row 12" not in text and "and 8 more" in text
        assert text.index("and 8 more") < text.index("note")
    whole = replace(table, rows=table.rows[:MOST])
    assert "more" not in str(whole)


def test_numbers_stand_on_the_right_and_words_on_the_left():
    table = Table("so", ("name", "value", "none"), [("a", "1.5", ""), ("longer", "−12 %", "")])
    assert str(table).splitlines()[1:] == ["name    value  none", "a         1.5", "longer  −12 %"]
    assert table.html().count("text-align:right") == 3


def test_an_empty_table_is_its_sentence():
    assert str(Table("so", ("a", "b"))) == "so" and "<table" not in Table("so", ("a", "b")).html()


def test_what_is_no_number_is_a_dash():
    assert [cell(value) for value in (None, float("nan"), float("inf"), 0.12345)] == ["–", "–", "–", "0.123"]


def warned():
    """An improvement whose draws have not converged."""
    better = improvement()
    judged = Convergence(np.asarray([1.5, 1.0, 1.0]), np.full(3, 900.0), 0)
    fit = replace(better.calibration.fit, convergence=judged)
    return replace(better, calibration=replace(better.calibration, fit=fit))


def test_the_warning_of_an_improved_model_is_shown(monkeypatch):
    assert "R-hat of A is 1.500" in repr(warned()) and "R-hat of A is 1.500" in warned()._repr_html_()
    monkeypatch.setattr("sys.stdout", kept := io.TextIOWrapper(io.BytesIO(), write_through=False))
    done = SimpleNamespace(trail=warned().trail, improvement=warned(), improved_location=None, remainder=None)
    tell(done, "improve")
    # In the file at once, not when a buffer is full.
    assert b"warning: R-hat of A is 1.500" in kept.buffer.getvalue()


def test_doubts_of_the_data_are_told(capsys):
    campaign = histories(1, 0)[0]
    record = campaign["E1"].record
    flipped = Record(record.time, {**record.channels, "force": -1e5 * np.gradient(record["elongation"], record.time)})
    given = replace(campaign, experiments=(replace(campaign["E1"], record=flipped),))
    tell(SimpleNamespace(campaign=given), "data")
    assert "doubt: E1, force" in (said := capsys.readouterr().out) and "is a sign flipped?" in said


def test_what_is_tabular_must_have_a_table():
    with pytest.raises(NotImplementedError):
        repr(Tabular())


def test_a_plain_notebook_is_not_told_to_install_widgets():
    # As a kernel without ipywidgets looks to tqdm, which numpyro loads; every warning is an error.
    code = (
        "import sys, types\n"
        "shell = types.SimpleNamespace(config={'IPKernelApp': 1})\n"
        "sys.modules['ipykernel.zmqshell'] = shell\n"
        "sys.modules['IPython'] = types.SimpleNamespace(get_ipython=lambda: shell)\n"
        "sys.modules['ipywidgets'] = None\n"
        "import hsed_jax.inference.priors\n"
    )
    done = subprocess.run([sys.executable, "-W", "always", "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "")
    without = code.replace("import hsed_jax.inference.priors", "import tqdm.auto")
    assert "IProgress" in subprocess.run([sys.executable, "-c", without], capture_output=True, text=True).stderr


def test_the_package_names_its_plots():
    assert {"plot", "initial_study", "calibrate"} <= set(dir(hx))
