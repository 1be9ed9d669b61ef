"""A campaign of long records, from `hsed init` to the report: every step, every figure and every table, thinned."""

import json
import re
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import pytest

from hsed_jax.command_line import main
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.reporting.page_tables import residual_table, samples_table
from hsed_jax.runs.reading import read_run

pytestmark = pytest.mark.whole

ROWS, SAMPLES = 50_000, 100
STIFFNESS, STRENGTH, CUBIC = 2e7, 1e5, 5e7  # N/m, N, N/m³
FIGURES = {
    "band_parts", "before_after", "behaviour", "cycles", "error_fall", "error_table", "overlay_W1", "overlay_W2",
    "parameters_before_after", "posterior", "ranking", "residual_coordinates",
}  # fmt: skip


def write_wall(folder) -> None:
    """A wall beside a cubic spring, pushed to and fro with growing amplitudes; the last two fifths are held out."""
    corners = np.concatenate([[0.0], np.repeat([10, 30, 60, 100], 4) * 1e-3 * np.tile([1, -1], 8), [0.0]])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])
    elongation = np.interp(np.linspace(0, way[-1], ROWS), way, corners)
    force = np.zeros(ROWS)
    for k, step in enumerate(np.diff(elongation), 1):
        towards = np.sign(step) * STRENGTH
        force[k] = towards + (force[k - 1] - towards) * np.exp(-abs(step) * STIFFNESS / STRENGTH)
    force += CUBIC * elongation**3 + 1e-3 * STRENGTH * np.random.default_rng(0).normal(size=ROWS)
    (folder / "records").mkdir(parents=True)
    columns = np.column_stack([0.01 * np.arange(ROWS), 1e3 * elongation, 1e-3 * force])
    np.savetxt(folder / "records" / "wall.csv", columns, "%.7g", ",", header="t,u,F", comments="")
    channels = "{time: {column: t, unit: s}, elongation: {column: u, unit: mm}, force: {column: F, unit: kN}}"
    (folder / "campaign.yaml").write_text(f"name: wall\nprotocol: displacement\ninputs: {{}}\nchannels: {channels}\n")
    lines = "W1,records/wall.csv,0,300,train\nW2,records/wall.csv,300,499.9,test\n"
    (folder / "experiments.csv").write_text(f"id,record,from,to,split\n{lines}")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a run of all steps that `hsed init` wrote, with few samples and one effect to find."""
    folder = tmp_path_factory.mktemp("long")
    write_wall(folder / "wall")
    assert main(["init", str(folder / "wall")]) == 0
    small = [f"measurements.samples={SAMPLES}", "calibration={sampler: laplace, starts: 1}"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hsed_jax.study.own_parts.EFFECTS", EFFECTS.only(["cubic_stiffness", "yield_sharpness"]))
        words = ["run", str(folder / "wall" / "study.yaml"), *small, "--output", str(folder / "run")]
        with redirect_stdout(StringIO()) as told:
            assert main(words) == 0
    (folder / "told.txt").write_text(told.getvalue())
    return folder / "run"


def test_every_step_figure_and_table_of_a_long_record_is_there(run):
    summary = json.loads((run / "summary.json").read_text())
    assert summary.keys() >= {"calibration", "comparison", "diagnosis", "improvement"}
    assert "left_out" not in summary
    assert {path.stem for path in (run / "figures").glob("*.svg")} == FIGURES
    page = (run / "report.html").read_text()
    for section in ("fall", "where", "histories", "cycles", "missing", "improvement", "posterior", "data"):
        assert f'<section id="{section}"' in page
    assert "could not be" not in page
    drawn = json.loads(re.search(r'id="content">(.*?)</script>', page, re.DOTALL)[1])
    assert drawn["charts"].keys() == {"where", "histories", "residual"}


def test_the_tables_of_the_page_are_of_the_samples_that_were_kept(run):
    finished = read_run(run)
    assert len(finished.campaign["W1"].record) == ROWS
    samples, residual = samples_table(finished), residual_table(finished)
    assert 0.8 * SAMPLES < samples["experiment"].count("W1") <= SAMPLES
    assert {"time [s]", "cycle", "elongation [mm]", "absorbed energy [kJ]"} <= {*residual["coordinate"]}
    assert max(residual["to"][i] for i, along in enumerate(residual["coordinate"]) if along == "time [s]") == 499.9
    assert {*samples["time"]} <= {*(0.01 * np.arange(ROWS)).round(2)}


def test_the_terminal_says_the_error_before_the_draws_what_probabilities_are_and_where_the_improved_model_fails(run):
    told = (run.parent / "told.txt").read_text()
    found = told.index("improve: the error on the fitted experiments is 0.00")
    assert found < told.index("the improved model, calibrated on 1 experiment")
    assert "whose formula is not in the catalogue" in told
    assert (
        told.count("the improved model: ") == 2
        and "where" in json.loads((run / "summary.json").read_text())["improvement"]["comparison"]
    )


def test_the_report_is_written_again_from_its_folder(run):
    before = (run / "report.html").read_bytes()
    assert main(["report", str(run)]) == 0
    assert (run / "report.html").read_bytes() == before
