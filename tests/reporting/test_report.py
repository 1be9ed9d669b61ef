"""The report of a run: its numbers are those of summary.json, nothing is fetched, a browser draws it and lets one choose."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from builders.outcomes import outcome
from builders.run_folders import ERRORS, HOSTILE, IDS, SENTENCE, campaign, record, summary, write

from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.left_out import LeftOut
from hsed_jax.measurements import Campaign, Experiment, Record, write_campaign
from hsed_jax.measurements.experiment import Channel
from hsed_jax.reporting import style
from hsed_jax.reporting.digest import verdict, warnings
from hsed_jax.reporting.inline_svg import inline
from hsed_jax.reporting.page_tables import error_of, residual_table, samples_table, thinned, unit_words
from hsed_jax.reporting.report import report_page
from hsed_jax.reporting.saving import Writer
from hsed_jax.runs import figures, reading
from hsed_jax.runs.reading import read_run


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "run")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """A report as the command writes it."""
    folder = write(tmp_path_factory.mktemp("report") / "run")
    assert main(["report", str(folder)]) == 0
    return folder / "report.html"


# The page itself.


@pytest.mark.whole
def test_the_check_of_an_exported_script_is_on_the_page(folder):
    assert 'id="export-check"' not in report_page(read_run(folder))
    (folder / "export").mkdir()
    (folder / "export" / "check.json").write_text('{"opensees": "3.7.1", "difference": 0.00321}', encoding="utf-8")
    page = report_page(read_run(folder))
    assert "was run in OpenSees 3.7.1 along export/protocol.csv" in page
    assert "differs from the simulation of this package by 0.321 %" in page
    (folder / "export" / "check.json").write_text("[]", encoding="utf-8")
    with pytest.raises(UserError, match=r"check\.json"):
        read_run(folder)


@pytest.mark.whole
def test_the_figures_on_the_page_are_those_of_the_summary(folder):
    page = report_page(read_run(folder))
    shown = dict(re.findall(r'<data value="([^"]+)" data-figure-key="([^"]+)"', page))
    values = {key: float(value) for value, key in shown.items()}
    known = json.loads((folder / "summary.json").read_text())
    assert values["error_train_before"] == known["comparison"]["train"]["error"]
    assert values["error_test_after"] == known["improvement"]["comparison"]["test"]["error"]
    assert values["noise_floor"] == 0.05
    assert values["probability_hardening"] == 0.9987
    assert 'data-figure-key="probability_hardening">0.999</data><span>probability of hardening' in page
    said = "With hardening the error on experiments that were not fitted goes from 0.350 to 0.055 (noise 0.050)."
    assert verdict(read_run(folder)) == f"{said} The noise does not explain the rest."
    missing = page[page.index("<h2>Missing effects") :]
    assert SENTENCE[1:] in missing and said not in missing


@pytest.mark.whole
def test_an_improvement_without_a_diagnosis_has_its_headline_and_what_is_ambiguous_stays_so(tmp_path):
    page = page_of(tmp_path, lambda found: found.pop("diagnosis"))
    assert "goes from 0.350 to 0.055" in page[: page.index("Key figures")]
    assert "does not explain the residual" not in page
    shutil.rmtree(tmp_path / "run")
    page = page_of(
        tmp_path, lambda found: found["diagnosis"].update(verdict="ambiguous", sentence="it is this or that")
    )
    head = page[: page.index("Key figures")]
    assert head.index("goes from 0.350 to 0.055") < head.index("It is this or that.")


@pytest.mark.whole
def test_a_hardening_below_zero_is_said_to_be_a_softening(tmp_path):
    def change(found):
        found["improvement"]["steps"][-1]["parameters"] = {"A": 5e5, "hardening.delta": -0.25}
        found["diagnosis"]["ranking"][0]["estimate"]["delta"] |= {"mean": -0.25, "q05": -0.3, "q95": -0.2}

    page = page_of(tmp_path, change)
    assert "With hardening (softening, as by P-Delta) the error" in page[: page.index("Key figures")]
    assert "<td>hardening (softening, as by P-Delta)</td>" in page
    assert '<th scope="row">+ hardening (softening, as by P-Delta)</th>' in page
    assert "softening" not in report_page(read_run(write(tmp_path / "plain")))


@pytest.mark.whole
def test_the_error_of_each_output_is_shown_where_the_error_over_all_hides_it(tmp_path):
    def change(found):
        for comparison, errors in (
            (found["comparison"], (0.5, 0.4)),
            (found["improvement"]["comparison"], (0.1, 0.39)),
        ):
            for output, error in zip(("elongation", "force"), errors, strict=True):
                comparison["test"]["per_output"][output]["nrmse"] = error

    page = page_of(tmp_path, change)
    row = '<td>test</td><td>{}</td><td class="number">{}</td><td class="number">{}</td><td class="number">{} %</td>'
    assert row.format("elongation", "0.500", "0.100", 6) in page and row.format("force", "0.400", "0.390", 94) in page


@pytest.mark.whole
def test_after_an_improvement_it_is_said_where_the_improved_model_fails(tmp_path):
    places = [{"sentence": "90 % of the squared error is after 3 s"}]
    page = page_of(tmp_path, lambda found: found["improvement"]["comparison"].update(where=places))
    own = page[page.index("<h2>Where it fails") :]
    assert (
        own.index("Misfit of the first model")
        < own.index("The improved model:")
        < own.index("90 % of the squared error")
    )
    shutil.rmtree(tmp_path / "run")
    page = page_of(tmp_path, lambda found: found["improvement"]["comparison"].update(where=[]))
    assert "The misfit of the improved model is not concentrated in any part of the data." in page


def test_outputs_that_demand_different_parameters_are_told_first(tmp_path):
    said = "force demands other parameters than elongation (chi2 191 with 2 degrees of freedom)"
    page = page_of(tmp_path, lambda found: found["calibration"].update(disagreement={"sentence": said}))
    assert page.index(f"Of the model as it was: {said}.") < page.index("The question")


def test_what_a_reader_must_know_stands_first(folder):
    said = list(warnings(read_run(folder)))
    assert any("3 divergent transitions" in text for text in said)
    page = report_page(read_run(folder))
    assert page.index("3 divergent transitions") < page.index("The question")


def page_of(tmp_path, change, records=record):
    """The page of a run whose summary is changed, and perhaps its records."""
    folder = write(tmp_path / "run")
    found = json.loads((folder / "summary.json").read_text())
    change(found)
    (folder / "summary.json").write_text(json.dumps(found))
    if records is not record:
        shutil.rmtree(folder / "campaign")
        known = campaign(("V_P", "T_P"))
        experiments = tuple(records(e) for e in known)
        write_campaign(replace(known, experiments=experiments), folder / "campaign")
    return report_page(read_run(folder))


def test_what_diverged_is_said_first_and_the_verdict_is_not_blue(tmp_path):
    def diverge(found):
        after = found["improvement"]["comparison"]
        del after["test"]["error"], after["test"]["per_experiment"]["T01"]["force"]["nrmse"]
        after["warnings"] = [
            "the simulation of T01 diverged at the MAP: its errors have no meaning, and it is not drawn"
        ]
        found["improvement"]["steps"][-1]["error_test"] = 1.3e8

    page = page_of(tmp_path, diverge)
    assert '<data value="" data-figure-key="error_test_after">diverged</data>' in page
    assert '<span class="tag doubtful" id="verdict">missing effects' in page
    first = page.index("The improved model: the simulation of T01 diverged at the MAP")
    assert first < page.index("The question")
    assert "130000000" not in page.replace(",", "") and page.count('<td class="number">diverged</td>') == 2


def test_doubts_of_the_data_are_quoted_first(tmp_path):
    def flipped(experiment):
        force = -1e4 * np.gradient(experiment.record["elongation"], experiment.record.time)
        return replace(
            experiment, record=Record(experiment.record.time, {**experiment.record.channels, "force": force})
        )

    page = page_of(tmp_path, lambda found: None, flipped)
    assert page.index("The data check has a doubt: E01, force: the work of force") < page.index("The question")


def test_a_window_is_shaded(tmp_path):
    page = page_of(tmp_path, lambda found: None, lambda e: replace(e, window=(1.0, 2.0)))
    assert '"windows":{"experiment":["E01","E02","T01"],"from":[1.0,1.0,1.0],"to":[2.0,2.0,2.0]}' in page
    assert "Shaded: the part of the record that is scored." in page


def test_the_posterior_says_whether_the_model_explains_the_data_and_the_scales_are_shown(tmp_path):
    doubt = "the model does not explain the data: its intervals are too narrow"
    scales = {"force": 1.2e5, "elongation": 0.023, "rate": 1.9, "energy": 2.2e4}

    def change(found):
        found["scales"] = scales
        found["calibration"] |= {"chi2_per_datum": 7.3, "doubt": doubt}

    page = page_of(tmp_path, change)
    assert "χ² per datum: 7.3 " in page[page.index("<h2>Posterior") :]
    above = page.lower()[: page.index("The question")]
    assert doubt.replace("the model", "the model as it was") in above
    assert doubt in page.lower()[page.index("<h2>Posterior") :]
    assert "force 120 kN, elongation 23 mm, elongation rate 1.9 m/s, absorbed energy 22 kJ" in page


def test_what_a_user_wrote_is_text_and_not_markup(folder):
    page = report_page(read_run(folder))
    assert HOSTILE not in page
    assert page.count("alert(") == page.count("&lt;script&gt;alert(") > 0
    assert "A fall &amp; &lt;more&gt;" in page


def test_the_page_names_no_other_place(folder):
    page = report_page(read_run(folder))
    own = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)  # the library's own script names its schemas
    assert re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?\s*(?:https?:)?//', own) == []
    assert len(page.encode()) < 2e6


def test_rebuilding_a_report_gives_the_same_page(page_file):
    before = page_file.read_bytes()
    assert main(["report", str(page_file.parent)]) == 0
    assert page_file.read_bytes() == before


def test_an_effect_that_an_improvement_leaves_out_is_said_beside_the_errors(tmp_path):
    note = "viscous_damping is not added: the error is 1.045 with it and 0.444 without it"
    page = page_of(tmp_path, lambda found: found["improvement"].update(notes=[note]))
    assert '<p class="note">Viscous damping is not added: the error is 1.045 with it and 0.444 without it.</p>' in page


def test_an_interrupted_run_has_a_report_that_says_so(folder):
    (folder / "results.nc").unlink()
    (folder / "summary.json").write_text(json.dumps({"study": "shown", "status": "interrupted"}))
    assert main(["report", str(folder)]) == 0
    assert "The run is not complete" in (folder / "report.html").read_text()


@pytest.mark.parametrize("inputs", [(), ("V_P",), ("V_P", "T_P")])
def test_a_report_of_any_number_of_inputs_can_be_written(tmp_path, inputs):
    page = report_page(read_run(write(tmp_path / "run", inputs)))
    assert all(f"{name} [" in page for name in inputs)


@pytest.mark.parametrize("missing", ["study.yaml", "summary.json"])
def test_a_folder_without_a_run_is_refused_in_one_line(folder, capsys, missing):
    (folder / missing).unlink()
    assert main(["report", str(folder)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and str(folder) in said and said.count("\n") == 1


def test_a_file_that_is_no_report_is_not_replaced(folder, tmp_path, capsys):
    mine = tmp_path / "mine.html"
    mine.write_text("my notes")
    assert main(["report", str(folder), "--output", str(mine)]) == 2
    assert mine.read_text() == "my notes"
    assert "choose another --output" in capsys.readouterr().err


@pytest.mark.whole
def test_two_runs_stand_side_by_side_with_what_differs(tmp_path):
    first = write(tmp_path / "first")
    other = write(tmp_path / "other", study="other")
    study = yaml.safe_load((other / "study.yaml").read_text())
    study["model"]["effects"] = {"hardening": {}}
    (other / "study.yaml").write_text(yaml.safe_dump(study | {"seed": 7}))
    output = tmp_path / "both.html"
    assert main(["report", str(first), str(other), "--output", str(output)]) == 0
    page = output.read_text()
    assert "<code>seed</code></th><td>0</td><td>7</td>" in page
    assert "<code>structure.masses</code>" not in page
    assert page.count('<data value="0.35"') == 2


# The numbers behind the charts.


def test_samples_are_those_measured_and_predicted(folder):
    run = read_run(folder)
    table = samples_table(run)
    rows = np.asarray(table["experiment"]) == "E02"
    measured = record(1)["force"] / 1e3
    assert np.asarray(table["force_measured"])[rows] == pytest.approx(measured, rel=1e-4, abs=1e-3)
    assert np.asarray(table["force_before"])[rows] == pytest.approx(1.4 * measured, rel=1e-4, abs=1e-3)
    assert np.asarray(table["elongation_after"])[rows] == pytest.approx(
        1.06e3 * record(1)["elongation"], rel=1e-4, abs=1e-3
    )


def test_the_residual_along_a_coordinate_is_the_rms_of_its_bin(folder):
    table = residual_table(read_run(folder))
    chosen = [
        (size, low, high)
        for size, low, high, *key in zip(
            table["residual"],
            table["from"],
            table["to"],
            table["coordinate"],
            table["output"],
            table["model"],
            strict=True,
        )
        if key == ["V_P [m/s]", "force", "before"]
    ]
    assert len(chosen) == 3  # three experiments, three values of the input
    for (size, low, high), id in zip(chosen, IDS, strict=True):
        force = record(IDS.index(id))["force"]
        assert low == high
        assert size == pytest.approx(ERRORS["before"][id] * np.sqrt(np.mean(force**2)) / 2e4, rel=1e-4)


def test_thinning_keeps_every_extreme():
    rng = np.random.default_rng(0)
    signal = np.sin(np.linspace(0, 40, 20_000)) + 0.01 * rng.normal(size=20_000)
    signal[12_345] = 9.0
    kept = thinned([signal], 300)
    assert kept.size <= 300
    assert (kept[0], kept[-1]) == (0, 19_999)
    assert np.all(np.diff(kept) > 0)
    assert signal[kept].max() == 9.0
    assert signal[kept].min() == signal.min()


def test_a_short_record_is_not_thinned():
    assert thinned([np.arange(50.0)], 300).tolist() == list(range(50))


@pytest.mark.parametrize(
    ("unit", "words"), [("m/s^2", "m/s²"), ("1/m^3", "1/m³"), ("N*s", "N·s"), ("1", "–"), ("kN", "kN")]
)
def test_units_in_words(unit, words):
    assert unit_words(unit) == words


def test_the_error_of_an_experiment_is_averaged_in_the_square():
    assert error_of({"force": {"nrmse": 0.3}, "elongation": {"nrmse": 0.4}}) == pytest.approx(np.sqrt(0.125))
    assert np.isinf(error_of({"force": {"nrmse": 0.3}, "elongation": {}}))  # not finite, hence not in the summary
    assert np.isnan(error_of({}))


@pytest.mark.parametrize(
    "inside",
    [
        "<script>alert(1)</script>",
        '<script xmlns="http://www.w3.org/1999/xhtml">alert(1)</script>',
        '<g onload="alert(1)"/>',
        '<g ONLOAD="alert(1)"/>',
        '<g class="warnings"/>',
        '<image href="https://elsewhere/x.png"/>',
        '<image xmlns:l="http://www.w3.org/1999/xlink" l:href="https://elsewhere/x.png"/>',
        '<image xmlns:l="http://www.w3.org/1999/xlink" l:href="data:image/svg+xml;base64,PHN2Zz4="/>',
        '<use xmlns:l="http://www.w3.org/1999/xlink" l:href="https://elsewhere/x.svg#a"/>',
        "<style>@import url(http://elsewhere/x.css);</style>",
        "<style>*{stroke-linejoin: round; stroke-linecap: butt} body{display: none}</style>",
        "<style>*{background: url(http://elsewhere)}</style>",
        '<g style="background: url(http://elsewhere/x.png)"/>',
        '<g style="fill: url(http://elsewhere/x.svg#a)"/>',
        r'<g style="fill: u\72l(http://elsewhere/x.svg#a)"/>',
        "<g style=\"background-image: image-set('http:elsewhere' 1x)\"/>",
        "<g style=\"fill: image-set('http:elsewhere' 1x)\"/>",
        '<g style="position: fixed"/>',
        '<g clip-path="url(http://elsewhere/x.svg#a)"/>',
        '<rect fill="url(http://elsewhere/x.svg#a)"/>',
        '<animate attributeName="href" values="javascript:alert(1)"/>',
        "<foreignObject/>",
        "<title><![CDATA[>]]></title><a/>",
    ],
)
def test_a_page_takes_no_script_and_no_address_from_somebodys_figure(inside):
    drawing = '<svg xmlns="http://www.w3.org/2000/svg">{}<path d="M 0 0"/></svg>'
    assert "<path" in inline("fine", drawing.format("<?x > <script>alert(1)</script> ?><!-- <script> -->")).svg
    assert "script" not in inline("fine", drawing.format("<?x > <script>alert(1)</script> ?><!-- <script> -->")).svg
    with pytest.raises(UserError, match=r"figures/worst\.svg: (it contains more than|this is not a) "):
        inline("worst", drawing.format(inside))


NAME = 'posterior_x" onload="document.title=1337" y="1'


def hostile(folder):
    """A run folder of somebody else, who wrote figures of his own."""
    drawing = '<svg xmlns="http://www.w3.org/2000/svg">{}<path d="M 0 0 L 9 9" id="a" style="stroke: #000000"/></svg>'
    (folder / "figures" / f"{NAME}.svg").write_text(drawing.format(""))
    (folder / "figures" / "posterior.svg").write_text(
        drawing.format("<style>@import url(http://127.0.0.1:9/x);</style>")
    )
    return folder


def test_the_name_of_a_figure_is_no_markup(folder):
    page = report_page(read_run(hostile(folder)))
    (element,) = re.findall(r'<svg [^>]*data-figure="posterior[^>]*>', page)
    assert "onload" in element  # within the mark, with no quote to end it
    assert re.sub(r'"[^"]*"', '""', element) == '<svg xmlns="" data-figure="" aria-hidden="">'
    assert "127.0.0.1" not in page and "figure posterior could not be made and is left out" in page


def test_an_inlined_figure_has_the_colours_of_the_page_in_its_lines_and_not_in_its_words():
    drawing = '<svg xmlns="http://www.w3.org/2000/svg"><text id="t" style="fill: #000000">id="#000000"</text></svg>'
    drawn = inline("one", drawing).svg
    assert 'id="one-t"' in drawn and "fill: var(--ink)" in drawn and '>id="#000000"<' in drawn


def test_an_inlined_figure_keeps_its_words_and_its_identifiers_to_itself(folder):
    text = (folder / "figures" / "error_fall.svg").read_text()
    figure = inline("error_fall", text)
    assert (figure.caption, figure.alt) == ("A fall & <more>", "It falls.")
    assert all(i.startswith("error_fall-") for i in re.findall(r'\bid="([^"]+)"', figure.svg))
    assert {i for i in re.findall(r"url\(#([^)]+)\)", figure.svg)} <= set(re.findall(r'\bid="([^"]+)"', figure.svg))
    assert style.BLACK not in figure.svg and "var(--ink)" in figure.svg


# In a browser.


@pytest.fixture
def opened(browser, page_file):
    """A factory: the report in a fresh tab, what it said on the console, and what it asked of the network."""
    pages = []

    def open(file=page_file, **settings):
        page = browser.new_page(**settings)
        pages.append(page)
        heard, asked = [], []
        page.on("console", lambda message: heard.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: heard.append(f"error: {error}"))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(file.as_uri())
        page.wait_for_function("document.documentElement.dataset.ready === 'true'")
        return page, heard, asked

    yield open
    for page in pages:
        page.close()


@pytest.mark.whole
def test_somebodys_run_folder_runs_nothing_and_asks_nobody(opened, tmp_path):
    folder = hostile(write(tmp_path / "run"))
    assert main(["report", str(folder)]) == 0
    page, heard, asked = opened(folder / "report.html")
    assert page.title() == "shown: report" and heard == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [(folder / "report.html").as_uri()]


def test_the_policy_of_the_page_lets_no_other_script_run(opened, page_file, tmp_path):
    added = "<script>document.title = 1337</script><p id='p' onclick='document.title = 1337'>x</p><img src='http://127.0.0.1:9/x'>"
    file = tmp_path / "added.html"
    file.write_text(page_file.read_text(encoding="utf-8").replace("</main>", f"{added}</main>"), encoding="utf-8")
    page, heard, _ = opened(file)
    page.click("#p")
    assert page.title() == "shown: report"
    assert len([text for text in heard if "Content Security Policy" in text]) == 3


def paths(page, chart):
    """The lines that a chart draws."""
    return page.eval_on_selector_all(
        f"#chart-{chart} svg .mark-line path", "paths => paths.map(p => p.getAttribute('d'))"
    )


def test_the_page_opens_in_silence_and_asks_nobody(opened, page_file):
    _, heard, asked = opened()
    assert heard == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [page_file.as_uri()]


def test_the_charts_are_drawn(opened):
    page, _, _ = opened()
    for chart in ("where", "residual", "histories"):
        assert page.locator(f"#chart-{chart} svg.marks").count() == 1
    assert page.locator("#chart-where svg .mark-symbol path").count() >= 3
    assert len(paths(page, "histories")) == 9  # three series in a loop and two histories
    assert page.locator(".still svg").count() == 1


def test_the_verdict_and_the_figures_are_those_of_the_summary(opened, page_file):
    page, _, _ = opened()
    known = json.loads((page_file.parent / "summary.json").read_text())
    assert page.inner_text("#verdict") == known["diagnosis"]["verdict"].replace("_", " ")
    # What the improvement has reached comes first.
    before, after = (f"{known['improvement']['steps'][place]['error_test']:.3f}" for place in (0, -1))
    assert f"goes from {before} to {after}" in page.inner_text("#sentence")
    assert page.inner_text('[data-figure-key="error_test_before"]') == f"{known['comparison']['test']['error']:.3f}"


def test_the_worst_experiment_is_shown_first_and_another_one_changes_the_plot(opened):
    page, heard, _ = opened()
    assert page.input_value("#experiment") == "E02"
    assert "error 0.400 as it was, error 0.060 improved" in page.inner_text("#about")
    before = paths(page, "histories")
    page.select_option("#experiment", "T01")
    page.wait_for_function(
        "before => document.querySelector('#chart-histories .mark-line path').getAttribute('d') !== before",
        arg=before[0],
    )
    assert "test; error 0.350" in page.inner_text("#about")
    assert heard == []


@pytest.mark.whole
def test_the_experiment_can_be_chosen_with_the_keyboard_alone(opened):
    page, _, _ = opened()
    page.focus("#next")
    page.keyboard.press("Enter")
    assert page.input_value("#experiment") == "T01"
    page.keyboard.press("Enter")
    assert page.input_value("#experiment") == "E01"


def test_a_point_of_the_map_chooses_its_experiment(opened):
    page, _, _ = opened()
    assert page.input_value("#experiment") == "E02"
    point = page.locator("#chart-where svg .mark-symbol.role-mark path").first
    point.scroll_into_view_if_needed()
    page.wait_for_timeout(200)
    box = point.bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert page.input_value("#experiment") == "E01"


def test_the_residual_is_shown_along_what_the_reader_chooses(opened):
    page, heard, _ = opened()
    ticks = "nodes => nodes.map(n => n.textContent).join(' ')"
    before = page.eval_on_selector_all("#chart-residual svg .role-axis-label text", ticks)
    page.locator("#chart-residual select").select_option("absorbed energy [kJ]")
    page.wait_for_timeout(300)
    assert page.eval_on_selector_all("#chart-residual svg .role-axis-label text", ticks) != before
    assert heard == []


@pytest.mark.whole
def test_the_time_axes_zoom_together_and_the_pointer_tells_the_values(opened):
    page, heard, _ = opened()
    cells = page.locator("#chart-histories svg [class*=voronoi]").first
    cells.scroll_into_view_if_needed()
    box = cells.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_selector("#vg-tooltip-element.visible")
    assert "as it was" in page.inner_text("#vg-tooltip-element")
    before = paths(page, "histories")
    page.keyboard.down("Shift")
    page.mouse.wheel(0, -400)
    page.wait_for_timeout(500)
    after = paths(page, "histories")
    assert [a == b for a, b in zip(before, after, strict=True)] == 3 * [True] + 6 * [False]  # the loop has no time
    assert heard == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_follows_the_system_until_the_reader_says_otherwise(opened, scheme):
    page, _, _ = opened(color_scheme=scheme)
    paper = "getComputedStyle(document.body).backgroundColor"
    ink = "getComputedStyle(document.querySelector('#chart-histories .role-axis-label text')).fill"
    first, drawn = page.evaluate(paper), page.evaluate(ink)
    brightness = sum(map(int, re.findall(r"\d+", first)[:3])) / 3
    assert (brightness > 128) == (scheme == "light")
    page.click("#theme")
    assert page.evaluate(paper) != first
    assert page.evaluate(ink) != drawn  # the charts turn with the page


def test_every_figure_has_words_for_who_cannot_see_it(opened):
    page, _, _ = opened()
    unnamed = page.eval_on_selector_all(
        "figure [role]",
        "nodes => nodes.filter(n => !n.getAttribute('aria-label') && n.getAttribute('role') !== 'presentation'"
        " && !n.closest('svg')).length",
    )
    assert unnamed == 0
    assert page.eval_on_selector_all(
        "figure", "nodes => nodes.every(n => n.querySelector('figcaption').textContent.trim())"
    )


def test_nothing_is_wider_than_the_page(opened):
    page, _, _ = opened(viewport={"width": 420, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 420


@pytest.mark.whole
def test_the_page_of_two_runs_draws_its_charts(opened, page_file, tmp_path):
    other = write(tmp_path / "other", study="other")
    output = tmp_path / "both.html"
    assert main(["report", str(page_file.parent), str(other), "--output", str(output)]) == 0
    page, heard, _ = opened(output)
    assert heard == []
    assert page.locator("#chart-errors svg .mark-rect path").count() >= 10
    assert page.locator("#chart-parameters svg.marks").count() == 1


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (None, "error: the noise that the campaign declares, otherwise an inferred noise."),
        ({"inflate": True}, "otherwise an inferred noise, and the residual beyond it."),
        ({"relative": 0.05, "correlated": False}, "error: 5 % of the RMS of each history."),
        (
            {"relative": 0.05, "discrepancy": True},
            "5 % of the RMS of each history, and a learned model discrepancy.",
        ),
        ({"force": {"unknown": True, "inflate": True}}, "error: force inferred, and the residual beyond it."),
    ],
)
def test_an_error_is_told_as_it_is_written(error, said):
    from hsed_jax import load_study
    from hsed_jax.reporting.asked import asked

    entries = {
        "study": "told",
        "model": {"spring": "elastic", "parameters": {"k": {"uniform": [1.0e5, 1.0e6]}}},
        "experiments": {"campaign": "measured"},
        "observe": "histories",
        "steps": ["calibrate"],
    }
    # As a run keeps it: with every default that there is.
    study = load_study(entries | ({"error": error} if error else {})).written()
    component = Record(np.arange(81), record(0).channels)
    declared = {"elongation": Channel("elongation", "m"), "force": Channel("force", "N")}
    sentences = asked(
        study,
        Campaign("measured", "displacement", channels=declared, experiments=(Experiment("E01", record=component),)),
    )
    assert said in " ".join(sentences)


# What fails.


def fail(*_, **__):
    raise ValueError("shapes (2,) (3,)")


@pytest.mark.parametrize(
    ("part", "name", "gone", "kept"),
    [
        ("tables.residual_table", "chart residual", '"residual":', '"histories":'),
        ("tables.samples_table", "chart histories", '"samples":', '"residual":'),
        ("_ranking", "table of effects", "812.5", '"residual":'),
        ("_experiments", "table of experiments", "<td>E02</td>", "812.5"),
        ("inline", "figure error_fall", "A fall &amp;", "812.5"),
    ],
)
def test_a_chart_or_table_that_fails_is_left_out_and_said(folder, monkeypatch, capsys, part, name, gone, kept):
    whole = report_page(read_run(folder))
    assert gone in whole and kept in whole
    monkeypatch.setattr(f"hsed_jax.reporting.report.{part}", fail)
    assert main(["report", str(folder)]) == 0
    page = (folder / "report.html").read_text()
    assert gone not in page and kept in page
    said = f"he {name} could not be made and is left out (ValueError: shapes (2,) (3,))"
    assert page.index(said) < page.index("The question") and f"warning: t{said}" in capsys.readouterr().err


def test_a_figure_that_fails_leaves_the_others_and_is_said(tmp_path, monkeypatch):
    def drawings(*_):
        figure = style.new_figure(2.0)
        figure.subplots()
        yield "broken", fail
        yield "whole", lambda: style.Picture(figure, "A caption.", "Words.")
        yield "without_material", lambda: None

    monkeypatch.setattr(figures, "_misfit_drawings", drawings)
    monkeypatch.setattr(figures, "_design_drawings", fail)
    for name in ("diagnosis_drawings", "_posterior_drawings"):
        monkeypatch.setattr(figures, name, lambda *_: iter(()))
    left_out = LeftOut()
    with Writer() as writer:
        figures.draw(outcome(), {}, tmp_path, writer, left_out)
    assert {path.name for path in tmp_path.iterdir()} == {"whole.png", "whole.svg"}
    assert left_out.reasons.keys() == {"set of figures of the design", "figure broken"}


def test_what_was_left_out_of_a_run_is_said_first_in_its_report(tmp_path):
    said = "the figure cycles could not be made and is left out (ValueError: it is empty)"
    page = page_of(tmp_path, lambda found: found.update(left_out=[said]))
    assert page.index(said[1:]) < page.index("The question")


@pytest.mark.parametrize("error", [OSError(28, "full"), KeyboardInterrupt(), RuntimeError("KeyboardInterrupt: ")])
def test_a_full_disk_and_an_interruption_are_no_faults_of_a_figure(error):
    def stop():
        raise error

    with pytest.raises(type(error)):
        LeftOut().attempt("figure", stop, None)


def without(content, *keys):
    """A mapping without one of its parts."""
    changed = json.loads(json.dumps(content))
    inner = changed
    for key in keys[:-1]:
        inner = inner[key]
    del inner[keys[-1]]
    return changed


def parts(content, before=()):
    """The path of every part of a summary."""
    for key, value in content.items() if isinstance(content, dict) else ():
        yield (*before, key)
        yield from parts(value, (*before, key))


@pytest.mark.whole
@pytest.mark.parametrize(("kind", "first"), [("missing", 0), ("number", 2), ("list", 4), ("text", 6), ("null", 8)])
def test_a_summary_that_lacks_a_part_makes_a_report_or_one_clear_message(folder, capsys, monkeypatch, kind, first):
    # The summary alone changes.
    tree = reading._tree(folder / "results.nc")
    monkeypatch.setattr(reading, "_tree", lambda results: tree)
    whole, instead = summary(), {"number": 3, "list": [1], "text": "x", "null": None}
    for path in list(parts(whole))[first::10]:
        changed = without(whole, *path)
        if kind != "missing":
            inner = changed
            for key in path[:-1]:
                inner = inner[key]
            inner[path[-1]] = instead[kind]
        (folder / "summary.json").write_text(json.dumps(changed))
        status = main(["report", str(folder)])
        said = capsys.readouterr().err
        assert status == 0 or (status == 2 and said.startswith("error: ") and said.count("\n") == 1), (path, said)


@pytest.mark.parametrize("seed", range(6))
def test_damaged_results_make_a_report_or_one_clear_message(folder, capsys, seed):
    content, draw = bytearray((folder / "results.nc").read_bytes()), np.random.default_rng(seed)
    for at in draw.integers(0, len(content) if seed % 2 else 4000, 4):
        content[at] = draw.integers(256)
    (folder / "results.nc").write_bytes(content)
    assert main(["report", str(folder)]) in (0, 2)
    assert "Traceback" not in capsys.readouterr().err


def test_results_that_declare_more_than_they_hold_are_not_loaded(folder, capsys):
    import h5py

    with h5py.File(folder / "results.nc", "a") as file:
        file.create_dataset("huge", shape=(4_000_000_000,), dtype=float, chunks=(1024,))
    assert main(["report", str(folder)]) == 2
    assert "are declared in a file of" in capsys.readouterr().err
