"""A model of one's own: written, run, changed, served."""

import os
import subprocess
import sys

import pytest

import engine
from engine.models.files import model_from
from tests.cli.test_commands import MINE


@pytest.mark.long
def test_what_is_written_runs_as_it_is(rbps, tmp_path):
    result = rbps("new", "pendulum.py")
    assert result.exit_code == 0, result.output
    assert "rbps serve --model pendulum.py" in result.stdout
    text = (tmp_path / "pendulum.py").read_text()
    assert "NAME" not in text
    assert "rbps models pendulum.py" in text
    model = model_from(str(tmp_path / "pendulum.py"))
    assert model.name == "pendulum"
    assert model.continuous
    shown = rbps("models", "pendulum.py").stdout
    for words in (
        "angle' = rate",
        "gravity over length",
        "What its check says",
        "Shapes, values and",
    ):
        assert words in shown
    assert "takes one parameter vector" not in shown  # it is written the fast way
    run = subprocess.run(
        [sys.executable, "pendulum.py"],
        cwd=tmp_path,
        env=os.environ,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    found = dict(
        line.split()[:2] for line in run.stdout.splitlines() if line.startswith(("w2", "d "))
    )
    assert float(found["w2"]) == pytest.approx(40.0, rel=0.05)
    assert float(found["d"]) == pytest.approx(0.8, abs=0.3)


def test_nothing_is_written_over(rbps, tmp_path):
    (tmp_path / "mine.py").write_text("here already")
    assert "such a file already" in rbps("new", "mine.py").stderr
    assert (tmp_path / "mine.py").read_text() == "here already"
    for name, words in (
        ("pendulum", "a name such as pendulum.py"),
        ("two-tanks.py", "of letters, digits and _"),
        ("nowhere/mine.py", "there is no folder"),
    ):
        result = rbps("new", name)
        assert result.exit_code == 2
        assert words in result.stderr


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("none.py", "there is no such file"),
        ("broken.py", "No module named"),
        ("mine.py:a", "has no 'a'"),
    ],
)
def test_a_model_that_is_named_and_cannot_be_used_stops_the_start(rbps, tmp_path, reference, words):
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "broken.py").write_text("import nowhere_at_all\n")
    result = rbps("serve", "--model", "mine.py", "--model", reference)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "mine" not in engine.model_names()
