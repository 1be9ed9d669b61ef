"""Effects of a user's own: named in the study, loaded from a file, part of everything."""

import re
from pathlib import Path

import pytest
import yaml

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
    yield tmp_path
    EFFECTS.pop("wave", None)


def test_the_example_of_the_documentation_joins_the_catalogue(folder, capsys):
    built = Built(load_study(folder / "study.yaml"))
    assert built.parameters[1]["wave.force"] == 2e3
    assert main(["effects", "wave", "--study", str(folder / "study.yaml")]) == 0
    assert "waves with the elongation" in capsys.readouterr().out


def test_a_changed_file_is_read_again(folder):
    study = load_study(folder / "study.yaml")
    Built(study)
    before = EFFECTS["wave"]
    Built(study)
    assert EFFECTS["wave"] is before
    text = (folder / "mine.py").read_text(encoding="utf-8").replace("post-yield", "another")
    (folder / "mine.py").write_text(text, encoding="utf-8")
    (folder / "mine.py").touch()
    Built(study)
    assert EFFECTS["wave"].family == "another"


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
        Built(load_study(folder / "study.yaml"))


@pytest.mark.parametrize("name", ["a\0b.py", "a" * 300])
def test_a_file_named_like_no_file_is_not_there(folder, name):
    study = yaml.safe_load(STUDY.format(effects="{}"))
    study["model"]["own_effects"] = [name]
    with pytest.raises(UserError, match=r"model\.own_effects: a.*there is no such file"):
        Built(load_study(study))


def test_a_file_that_is_no_python_is_one_clear_message(folder):
    (folder / "mine.txt").write_text("x = 1", encoding="utf-8")
    with pytest.raises(UserError, match=r"model\.own_effects: mine\.txt: .*\.py"):
        Built(load_study(folder / "study.yaml", ["model.own_effects=[mine.txt]"]))
