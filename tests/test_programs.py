"""Programs whose traces are kept: the same numbers, found again by another process, made anew where anything differs."""

import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.places import ROOT

from hsed_jax.programs import program

TRACED = []


class Twice(NamedTuple):
    """A result."""

    value: jax.Array
    square: jax.Array


class Scaled(eqx.Module):
    """A static part and an array."""

    factor: jax.Array
    name: str = eqx.field(static=True, default="")


def doubled(model, x, power):
    """A function that tells when it is traced."""
    TRACED.append(power)
    return Twice(model.factor * x, x**power)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of its own, in which functions of this file are known by their names."""
    monkeypatch.setattr("hsed_jax.programs._KNOWN", {"builtins", "jax", __name__.partition(".")[0]})
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    TRACED.clear()
    yield tmp_path
    jax.config.update("jax_compilation_cache_dir", before)


def files(folder: Path) -> list[Path]:
    """The programs that were kept."""
    return sorted(path for path in (folder / "programs").rglob("*") if path.is_file())


def test_programs_that_were_not_used_for_longest_are_given_up(folder, monkeypatch):
    monkeypatch.setattr("hsed_jax.programs._MOST", 2)
    cubes, model, x = program(doubled), Scaled(jnp.asarray(3.0), "a"), jnp.arange(4.0)
    for power in (2, 3, 2, 4):
        cubes(model, x, power)
    # Given up is what is in memory; without its file it has to be traced again.
    for file in files(folder):
        file.unlink()
    TRACED.clear()
    for power in (2, 4, 3):
        np.testing.assert_array_equal(cubes(model, x, power).square, x**power)
    assert set(TRACED) == {3}


def test_a_kept_program_is_not_traced_again(folder):
    model, x = Scaled(jnp.asarray(3.0), "a"), jnp.arange(4.0)
    first = program(doubled)(model, x, 2)
    assert TRACED and len(files(folder)) == 1
    TRACED.clear()
    again = program(doubled)(model, 2 * x, 2)  # another object, as another process has
    assert not TRACED
    assert isinstance(again, Twice)
    np.testing.assert_array_equal(first.value, 3 * x)
    np.testing.assert_array_equal(again.value, 6 * x)
    np.testing.assert_array_equal(again.square, 4 * x**2)


@pytest.mark.parametrize(
    "other",
    [
        (Scaled(jnp.asarray(3.0), "b"), jnp.arange(4.0), 2),
        (Scaled(jnp.asarray(3.0), "a"), jnp.arange(5.0), 2),
        (Scaled(jnp.asarray(3.0), "a"), jnp.arange(4), 2),
        (Scaled(jnp.asarray(3.0), "a"), jnp.arange(4.0), 3),
        (Scaled(jnp.asarray(3.0), "a"), jnp.arange(4.0), 2.0),
    ],
)
def test_another_static_part_shape_or_type_is_another_program(folder, other):
    program(doubled)(Scaled(jnp.asarray(3.0), "a"), jnp.arange(4.0), 2)
    TRACED.clear()
    found = program(doubled)(*other)
    assert TRACED and len(files(folder)) == 2
    np.testing.assert_array_equal(found.square, other[1] ** other[2])


def test_what_has_no_name_is_traced_as_ever(folder):
    offset = 1.0

    def local(x):
        return x + offset

    def applied(function, x):
        return function(x)

    assert program(applied)(local, jnp.asarray(2.0)) == 3.0
    assert not files(folder)


def test_a_damaged_file_is_made_anew(folder):
    model, x = Scaled(jnp.asarray(3.0)), jnp.arange(4.0)
    program(doubled)(model, x, 2)
    (file,) = files(folder)
    for content in (b"", b"garbage", file.read_bytes()[:100]):
        file.write_bytes(content)
        np.testing.assert_array_equal(program(doubled)(model, x, 2).value, 3 * x)
    assert len(file.read_bytes()) > 1000


def test_without_a_folder_to_write_it_works_all_the_same(tmp_path, monkeypatch, folder):
    (folder / "programs").write_text("a file in its place")
    np.testing.assert_array_equal(program(doubled)(Scaled(jnp.asarray(3.0)), jnp.ones(2), 2).value, [3.0, 3.0])


def test_however_it_is_called_it_is_the_same_program(folder):
    one, model, x = program(doubled), Scaled(jnp.asarray(3.0)), np.arange(4.0)
    found = [one(model, x, 2), one(model, jnp.asarray(x), power=2), one(x=x, power=2, model=model)]
    assert len(files(folder)) == len(one._made) == 1
    for other in found[1:]:
        np.testing.assert_array_equal(other.square, found[0].square)


def test_what_another_kept_program_made_is_not_compiled_for_anew(folder, caplog):
    one, model, x = program(doubled), Scaled(jnp.asarray(3.0)), np.arange(4.0)
    made = one(model, x, 2)
    with jax.log_compiles():
        again = one(model, made.square, 2)
    assert not [record for record in caplog.records if "ompil" in record.getMessage()]
    np.testing.assert_array_equal(again.square, x**4)


class Held(eqx.Module):
    """A method that is a program."""

    factor: jax.Array

    @program
    def times(self, x):
        """The product."""
        TRACED.append(None)
        return self.factor * x


def test_a_method_is_kept_for_all_objects_of_a_kind(folder):
    assert Held(jnp.asarray(3.0)).times(jnp.asarray(2.0)) == 6.0
    assert Held(jnp.asarray(4.0)).times(jnp.asarray(2.0)) == 8.0
    assert len(TRACED) == 1 and len(files(folder)) == 1


def test_within_another_program_it_is_a_part_of_it(folder):
    one = program(doubled)
    slope = jax.jit(jax.grad(lambda x: one(Scaled(jnp.asarray(3.0)), x, 2).square))(5.0)
    assert slope == 10.0
    many = jax.vmap(lambda x: one(Scaled(jnp.asarray(3.0)), x, 2).value)(jnp.arange(3.0))
    np.testing.assert_array_equal(many, [0.0, 3.0, 6.0])


def test_programs_of_many_states_of_the_sources_do_not_pile_up(folder, monkeypatch):
    for number in range(7):
        monkeypatch.setattr("hsed_jax.programs._state", lambda number=number: f"state{number}")
        program(doubled)(Scaled(jnp.asarray(3.0)), jnp.ones(2), 2)
    states = sorted(path.name for path in (folder / "programs").iterdir())
    assert len(states) == 4 and states[-1] == "state6"


SIMULATED = """
import sys
import hsed_jax as hx
study = hx.load_study("configs/paper.yaml", ["excitation.duration=2", "experiments.virtual.effects={}"])
from hsed_jax.programs import Program
traced = []
made = Program._lowered
Program._lowered = lambda self, *a: traced.append(1) or made(self, *a)
table = hx.simulate(study, {"T_P": [0.4, 0.8], "V_P": [0.5, 0.4]}, channels=())
print(len(traced), float(table.quantities["dissipated_energy"].sum()))
"""


@pytest.mark.whole
def test_a_new_process_finds_what_the_last_one_traced(tmp_path):
    root = ROOT
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": str(root)}
    told = []
    for _ in range(2):
        command = [sys.executable, "-c", SIMULATED]
        done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        told.append(done.stdout.split())
    assert int(told[0][0]) > 0 and int(told[1][0]) == 0
    assert told[0][1] == told[1][1]
