"""The README can be trusted: its commands are those of CI, its code exists, its figures are those of the benchmarks."""

import ast
import json
import re
from statistics import median

from builders.places import ROOT
from opensees_files import ALL, NOISE

import hsed_jax as hx
from hsed_jax.behaviour.names import FAR, LATER_FAR, RIGHT, RIGHT_FAR

README = (ROOT / "README.md").read_text(encoding="utf-8")


def kept(name):
    return json.loads((ROOT / "benchmarks" / name).read_text(encoding="utf-8"))


def blocks(language=""):
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)


def test_it_is_read_in_minutes():
    assert len(README.split()) < 900


def test_the_two_commands_stand_alone_and_ci_runs_the_tests_by_theirs():
    commands = [block.strip() for block in blocks() if block.startswith("python3 -m pip install uv &&")]
    assert len(commands) == 2 and all("\n" not in command for command in commands)
    run, test = commands
    assert run.endswith("python -m hsed_jax.run configs/paper.yaml") and (ROOT / "configs" / "paper.yaml").is_file()
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert f"\n{test} " in ci
    # The first command installs no group: a group has to be named.
    assert "--group" not in run and "--group" in test
    assert "default-groups = []" in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_its_python_is_short_and_calls_what_exists():
    (code,) = blocks("python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    called = {
        node.attr
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "hx"
    }
    assert called and called <= set(dir(hx))


def answers():
    """The answers of the table on reliability, by their questions."""
    section = README.split("## How reliable\n")[1].split("\n## ")[0]
    return dict(re.findall(r"^\| ([A-Z][^|]*\?) \| ([^|]*) \|", section, re.MULTILINE))


def test_how_often_a_name_is_wrong_is_what_the_benchmark_found():
    rows = kept("hidden_effects_scored.json")
    controls = [row for row in rows if row["group"].startswith("control")]
    # Rows without a verdict are formulas that cannot be made so strong; "adequate" and "absorbed" ones the noise explains.
    mixed = [row for row in rows if row["group"].startswith("mixed") and "verdict" in row]
    seen = [row for row in mixed if row["verdict"] != "adequate" and not row["absorbed"]]
    said = answers()
    assert said["Does it name an effect where none is missing?"] == (
        f"in {sum(bool(row['named']) for row in controls)} of {len(controls)} control campaigns"
    )
    exact, family = (sum(bool(row[key]) for row in seen) for key in ("exact", "family"))
    assert said["How often is the name right if the specimen follows no formula of the catalogue?"] == (
        f"the exact set in {exact} of {len(seen)} cases, the right family in {family} of {len(seen)}"
    )


def test_the_errors_of_real_specimens_are_those_that_were_measured():
    lines = (ROOT / "benchmarks" / "board.jsonl").read_text(encoding="utf-8").splitlines()
    rows = [row for row in map(json.loads, lines) if "named" in row.get("own", {}).get("last rows", {})]
    runs = [row["own"]["last rows"] for row in rows]
    named, plain = (median(run[key] for run in runs) for key in ("named", "plain"))
    other = median(row["comparisons"]["last rows"]["Bouc-Wen-Baber-Noori"]["held"] for row in rows)
    assert answers()["What is the error on real specimens that were not fitted?"] == (
        f"median {named:.2f} on {len(runs)} records; of the plain law {plain:.2f}; of the best other law {other:.2f}"
    )
    # The caption says so.
    assert all(run["named"] > run["noise"] for run in runs)


def test_the_share_of_right_names_is_that_of_formulas_which_are_not_in_the_catalogue():
    rows = [row for row in kept("hidden_effects_unseen.json") if "skipped" not in row]
    seen = [row for row in rows if row["verdict"] != "adequate" and not row["absorbed"]]
    sure = [
        effect in {hidden for hidden, _ in row["case"]["effects"]}
        for row in seen
        for effect, weight, _ in row["ranking"]
        if effect in row["named"] and weight >= 0.999
    ]
    assert (sum(sure), len(sure)) == (119, 128) and round(119 / 128, 2) == RIGHT


def test_the_share_of_right_names_far_above_the_noise_is_that_of_the_opensees_specimens():
    names = [
        (row["errors"][1] > FAR * NOISE, place > 0, effect in ALL[row["name"]].right)
        for row in kept("opensees_files.json")
        for place, effect in enumerate(row["effects"])
    ]
    first, later = ([right for far, is_later, right in names if far and is_later == side] for side in (False, True))
    assert (sum(first), len(first), sum(later), len(later)) == (10, 16, 7, 18)
    assert (round(10 / 16, 2), round(7 / 18, 2)) == (RIGHT_FAR, LATER_FAR)
    near = [right for far, _, right in names if not far]
    assert (sum(near), len(near)) == (14, 16)
    # The cases of the other share are all near.
    errors = [row["error"] for row in kept("hidden_effects_unseen.json") if "error" in row]
    assert len(errors) > 200 and all(after < FAR * noise for _, after, noise in errors)
