"""Effects of a user's own: named in the study, loaded from a file, part of everything."""

import re
from pathlib import Path

import pytest

from hsed_jax.config.build import Built
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.run import main

DOCS = Path(__file__).resolve().parents[1] / "docs"
STUDY = """
study: own
model:
  parameters: {{A: {{uniform: [1.0e6, 9.0e6]}}, beta: 40.0}}
  own_effects: [mine.py]
  effects: {effects}
experiments: {{campaign: nowhere}}
steps: [calibrate]
"""


@pytest.fixture
def folder(tmp_path):
    """A study beside the example of the documentation."""
    page = (DOCS / "effects.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "mine.py").write_text(example, encoding="utf-8")
    (tmp_path / "study.yaml").write_text(STUDY.format(effects="{wave: {force: 2.0e3}}"), encoding="utf-8")
    return tmp_path


def test_the_example_of_the_documentation_joins_the_catalogue(folder, capsys):
    built = Built(load_study(folder / "study.yaml"))
    assert built.parameters[1]["wave.force"] == 2e3
    assert main(["effects", "wave", "--study", str(folder / "study.yaml"), "--trust"]) == 0
    assert "waves with the elongation" in capsys.readouterr().out


def test_a_changed_file_is_read_again(folder):
    study = load_study(folder / "study.yaml")
    before = Built(study).catalogue["wave"]
    assert Built(study).catalogue["wave"] is before
    text = (folder / "mine.py").read_text(encoding="utf-8").replace("post-yield", "another")
    (folder / "mine.py").write_text(text, encoding="utf-8")
    (folder / "mine.py").touch()
    assert Built(study).catalogue["wave"].family == "another"


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
    assert [b.catalogue["wave"].family for b in (ours, theirs)] == ["post-yield", "another"]
    # By which compiled programs are told apart, and shared.
    assert ours.catalogue != theirs.catalogue and ours.catalogue == Built(study).catalogue
    assert hash(ours.catalogue) == hash(Built(study).catalogue)
    assert Built(plain).catalogue == EFFECTS and "wave" not in EFFECTS and len(ours.catalogue) == len(EFFECTS) + 1


def test_an_effect_is_given_from_python(folder):
    wave = Built(load_study(folder / "study.yaml")).catalogue["wave"]
    study = load_study(folder / "study.yaml", ["model.own_effects=[]"])
    with pytest.raises(UserError, match="no such effect"):
        _ = Built(study).parameters
    assert Built(study.with_own_effects(wave)).parameters[1] == {"beta": 40.0, "wave.force": 2e3}


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
    ],
)
def test_a_file_that_cannot_be_used_is_one_clear_message(folder, text, words):
    (folder / "mine.py").unlink()
    if text is not None:
        (folder / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=rf"model\.own_effects: mine\.py: .*{words}"):
        Built(load_study(folder / "study.yaml")).check()
