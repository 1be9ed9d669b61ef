"""The process that writes figures."""

import os
import signal

import pytest

from hsed_jax.reporting import style
from hsed_jax.reporting.saving import Writer


def _picture() -> style.Picture:
    figure = style.new_figure(2.0)
    figure.subplots().plot([0.0, 1.0], [0.0, 2.0], label="a line")
    figure.axes[0].set(xlabel="Time [s]", ylabel=r"Force $r$ [kN]")
    return style.Picture(figure, "A caption.", "Words.")


def test_the_process_writes_the_files_that_this_one_would(tmp_path):
    style.save(_picture(), tmp_path / "here", "figure")
    with Writer() as writer:
        picture = _picture()
        writer.write(picture.figure, picture.caption, picture.alt, tmp_path / "there", "figure").result()
    for ending in ("png", "svg"):
        here, there = ((tmp_path / of / f"figure.{ending}").read_bytes() for of in ("here", "there"))
        assert here == there


def test_an_error_of_a_figure_is_its_own_and_the_next_one_is_written(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with Writer() as writer:
        wrong, picture = _picture(), _picture()
        wrong.figure.axes[0].set_xlabel(r"$\nonsense$")
        first = writer.write(wrong.figure, "", "", tmp_path, "wrong")
        second = writer.write(picture.figure, "", "", tmp_path / "file", "nowhere")
        third = writer.write(picture.figure, "", "", tmp_path, "right")
        with pytest.raises(ValueError, match="nonsense"):
            first.result()
        with pytest.raises(OSError):
            second.result()
        third.result()
    assert (tmp_path / "right.svg").exists()


def test_a_process_that_was_killed_is_said(tmp_path):
    with Writer() as writer:
        os.kill(writer._process.pid, signal.SIGKILL)
        picture = _picture()
        with pytest.raises(RuntimeError, match="the process that writes figures has ended"):
            writer.write(picture.figure, "", "", tmp_path, "figure").result()


def test_an_interruption_ends_the_process_at_once():
    with pytest.raises(KeyboardInterrupt), Writer() as writer:
        raise KeyboardInterrupt
    assert writer._process.returncode == -signal.SIGKILL
