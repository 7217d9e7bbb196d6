"""The commands of the Guide, typed as they stand there: "From the shell", and the fifteen minutes."""

import re
import shlex
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

import engine.data

PAGES = Path(__file__).parents[2] / "service" / "guide" / "pages"


def commands(page):
    """The lines in a page's blocks of shell that begin with ``rbps``, without their comments."""
    blocks = re.findall(r"```sh\n(.*?)```", (PAGES / page).read_text(encoding="utf-8"), re.DOTALL)
    lines = [line.strip() for line in re.sub(r"\\\n", " ", "\n".join(blocks)).splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if re.match(r"rbps \w", line)]


def run_all(rbps, page, tmp_path):
    """What each command prints."""
    said = []
    for arguments in commands(page):
        if arguments[0] == "serve":
            continue  # it stays; tests of its own start and stop it
        result = rbps(*arguments)
        assert result.exit_code == 0, (arguments, result.output)
        for option, value in pairwise(arguments):
            if option in ("--out", "--report", "--plot"):
                assert (tmp_path / value).exists()
        said.append(result.stdout)
    return said


@pytest.mark.slow
def test_the_commands_from_the_shell_work(rbps, tmp_path):
    from engine.data import nile
    from engine.data.files import write_series

    write_series(nile(), tmp_path / "flows.csv")
    said = run_all(rbps, "shell.md", tmp_path)
    (diagnosis,) = (one for one in said if one.startswith("Diagnosis of model"))
    assert "NAMED" in diagnosis
    assert "coulomb:velocity" in diagnosis
    assert "Hardest to tell apart" in said[-1]  # the next experiment, from that diagnosis
    assert (tmp_path / "input.csv").stat().st_size > 0


@pytest.mark.slow
def test_the_fifteen_minutes_end_with_the_drag_that_was_hidden(rbps, tmp_path):
    said = run_all(rbps, "start.md", tmp_path)
    diagnosis, estimate, _, comparison = said[-4:]
    assert "NAMED" in diagnosis
    size, error = re.search(r"\[drag:rate\]: (\S+) \+- (\S+) 1/rad", diagnosis).groups()
    assert abs(float(size) - 0.4) < 2.0 * float(error)
    (line,) = (one for one in estimate.splitlines() if one.startswith("drag_rate"))
    assert float(line.split()[1]) == pytest.approx(0.4, abs=0.1)
    (likelihood,) = (one for one in comparison.splitlines() if one.startswith("log-likelihood"))
    assert float(likelihood.split()[-1]) > 10.0  # nats that the drag is worth
    assert "no drag" in comparison


@pytest.mark.slow
def test_the_measured_record_in_the_shell(rbps, tmp_path):
    shutil.copy(Path(engine.data.__file__).parent / "nile.csv", tmp_path)
    diagnosis, _, stepped, comparison = run_all(rbps, "measured.md", tmp_path)
    assert "NAMED" in diagnosis
    assert "time 1899 year" in diagnosis
    (line,) = (one for one in stepped.splitlines() if one.startswith("step_flow "))
    assert float(line.split()[1]) == pytest.approx(-248.0, abs=3.0)
    (likelihood,) = (one for one in comparison.splitlines() if one.startswith("log-likelihood"))
    assert float(likelihood.split()[-1]) > 8.0  # nats that the step is worth
