"""Effects of a user's own: named in the study, loaded from a file, part of everything."""

import re

import pandas as pd
import pytest
import yaml
from builders.places import ROOT

from hsed_jax.command_line import main
from hsed_jax.config.load import load_study, parse_yaml
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, write_campaign
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.runs.folder import RunFolder
from hsed_jax.study.build import Built

DOCS = ROOT / "docs"
STUDY = """
study: own
model:
  parameters: {{A: {{uniform: [1.0e6, 9.0e6]}}, beta: 40.0}}
  own_effects: [mine.py]
  effects: {effects}
experiments: {{campaign: nowhere}}
steps: [calibrate]
"""
CAMPAIGN = Campaign("measured", "displacement")


@pytest.fixture
def folder(tmp_path):
    """A study beside the example of the documentation."""
    page = (DOCS / "effects.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "mine.py").write_text(example, encoding="utf-8")
    (tmp_path / "study.yaml").write_text(STUDY.format(effects="{wave: {force: 2.0e3}}"), encoding="utf-8")
    return tmp_path


def test_the_example_of_the_documentation_joins_the_catalogue(folder, capsys):
    built = Built(load_study(folder / "study.yaml"), CAMPAIGN)
    assert built.mechanics.parameters[1]["wave.force"] == 2e3
    assert main(["effects", "wave", "--study", str(folder / "study.yaml"), "--trust"]) == 0
    assert "waves with the elongation" in capsys.readouterr().out


def test_a_changed_file_is_read_again(folder):
    study = load_study(folder / "study.yaml")
    before = Built(study).mechanics.catalogue["wave"]
    assert Built(study).mechanics.catalogue["wave"] is before
    text = (folder / "mine.py").read_text(encoding="utf-8").replace("post-yield", "another")
    (folder / "mine.py").write_text(text, encoding="utf-8")
    (folder / "mine.py").touch()
    assert Built(study).mechanics.catalogue["wave"].family == "another"


def test_an_effect_belongs_to_the_study_that_names_its_file(folder):
    study = load_study(folder / "study.yaml")
    other = folder / "other"
    other.mkdir()
    text = (folder / "mine.py").read_text(encoding="utf-8").replace("post-yield", "another")
    (other / "mine.py").write_text(text, encoding="utf-8")
    (other / "study.yaml").write_text((folder / "study.yaml").read_text())
    plain = load_study(folder / "study.yaml", ["model.own_effects=[]", "model.effects={}"])
    ours, theirs = Built(study), Built(load_study(other / "study.yaml"))
    # One name, two effects; and a study beside them knows neither.
    assert [b.mechanics.catalogue["wave"].family for b in (ours, theirs)] == ["post-yield", "another"]
    # By which compiled programs are told apart, and shared.
    assert (
        ours.mechanics.catalogue != theirs.mechanics.catalogue
        and ours.mechanics.catalogue == Built(study).mechanics.catalogue
    )
    assert hash(ours.mechanics.catalogue) == hash(Built(study).mechanics.catalogue)
    assert (
        Built(plain).mechanics.catalogue == EFFECTS
        and "wave" not in EFFECTS
        and len(ours.mechanics.catalogue) == len(EFFECTS) + 1
    )


def test_an_effect_is_given_from_python(folder):
    wave = Built(load_study(folder / "study.yaml")).mechanics.catalogue["wave"]
    study = load_study(folder / "study.yaml", ["model.own_effects=[]"])
    with pytest.raises(UserError, match="no such effect"):
        _ = Built(study, CAMPAIGN).mechanics.parameters
    assert Built(study.with_own_effects(wave), CAMPAIGN).mechanics.parameters[1] == {"beta": 40.0, "wave.force": 2e3}


def test_a_name_that_is_taken_is_refused(folder):
    text = (folder / "mine.py").read_text(encoding="utf-8").replace('"wave"', '"slip"')
    (folder / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=r"model\.own_effects: two effects are named 'slip'"):
        Built(load_study(folder / "study.yaml")).check()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is no such file"),
        ("x = 1", "registers no effect"),
        ("x = 1 / 0", "ZeroDivisionError"),
        ("def f(:", "SyntaxError"),
        ("\0", "SyntaxError"),
        ("import sys; sys.exit(0)", "SystemExit"),
    ],
)
def test_a_file_that_cannot_be_used_is_one_clear_message(folder, text, words):
    (folder / "mine.py").unlink()
    if text is not None:
        (folder / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=rf"model\.own_effects: mine\.py: .*{words}"):
        Built(load_study(folder / "study.yaml")).check()


@pytest.mark.parametrize("name", ["a\0b.py", "a" * 300])
def test_a_file_named_like_no_file_is_not_there(folder, name):
    study = yaml.safe_load(STUDY.format(effects="{}"))
    study["model"]["own_effects"] = [name]
    with pytest.raises(UserError, match=r"model\.own_effects: a.*there is no such file"):
        Built(load_study(study)).check()


def test_a_file_that_is_no_python_is_one_clear_message(folder):
    (folder / "mine.txt").write_text("x = 1", encoding="utf-8")
    with pytest.raises(UserError, match=r"model\.own_effects: mine\.txt: .*\.py"):
        Built(load_study(folder / "study.yaml", ["model.own_effects=[mine.txt]"])).check()


# --- looking executes nothing ------------------------------------------------------------------------------------


@pytest.fixture
def foreign(tmp_path):
    """A run of somebody else's, whose study names code that leaves a mark when it is executed."""
    mark = f"import pathlib\npathlib.Path({str(tmp_path / 'mark')!r}).touch()\n"
    for name in ("evil.py", "rig.py"):
        (tmp_path / name).write_text(mark)
    store = RunFolder(tmp_path / "run", load_study(parse_yaml(STUDY.format(effects="{wave: {}}"), "study")).written())
    content = yaml.safe_load((store.path / "study.yaml").read_text())
    content["model"]["own_effects"] = ["../evil.py"]
    (store.path / "study.yaml").write_text(yaml.safe_dump(content))
    store.write_summary({"study": "own", "status": "complete", "references": {"wave": "their own tests"}})
    table = pd.DataFrame({"id": ["E01"], "peak_force": [1.0]})
    write_campaign(
        Campaign.from_frames(table, protocol="ground_motion", quantities={"peak_force": "N"}), store.campaign
    )
    store.close()
    return tmp_path


def test_a_report_of_somebodys_run_executes_none_of_their_code(foreign):
    assert main(["report", str(foreign / "run")]) == 0
    assert not (foreign / "mark").exists()
    assert "their own tests" in (foreign / "run" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("words", [["check"], ["run", "--check"], ["effects", "--study"]])
@pytest.mark.parametrize("code", ["evil.py", "rig.py"])
def test_looking_at_somebodys_study_asks_for_trust(foreign, words, code, capsys):
    path = foreign / "run" / "study.yaml"
    if code == "rig.py":
        content = yaml.safe_load(path.read_text())
        content["model"]["own_effects"], content["experiments"] = [], {"python": "../rig.py"}
        path.write_text(yaml.safe_dump(content))
    assert main([*words, str(path)]) == 2
    assert (
        f"names code of its own ('../{code}'), which this command would execute; say --trust" in capsys.readouterr().err
    )
    assert not (foreign / "mark").exists()


def test_trust_lets_a_check_execute_it(foreign, capsys):
    assert main(["check", str(foreign / "run" / "study.yaml"), "--trust"]) == 2
    assert (foreign / "mark").exists() and "registers no effect" in capsys.readouterr().err
