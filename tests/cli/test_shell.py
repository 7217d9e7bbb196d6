"""The commands of the README's section "From the shell", typed as they stand there."""

import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"


def commands():
    """The lines of the section that begin with ``rbps``, without their comments."""
    section = README.read_text(encoding="utf-8").partition("### From the shell")[2]
    block = re.split(r"^##", section, maxsplit=1, flags=re.MULTILINE)[0]
    lines = [line.strip() for line in re.sub(r"\\\n", " ", block).splitlines()]
    return [shlex.split(line, comments=True)[1:] for line in lines if re.match(r"rbps \w", line)]


@pytest.mark.skipif(not commands(), reason="the README's section has no rbps commands")
def test_the_readmes_commands_work(rbps, tmp_path):
    from engine.data import nile
    from engine.data.files import write_series

    write_series(nile(), tmp_path / "flows.csv")
    for arguments in commands():
        if arguments[0] == "serve":
            continue  # it stays; tests of its own start and stop it
        result = rbps(*arguments)
        assert result.exit_code == 0, (arguments, result.output)
        for option, value in pairwise(arguments):
            if option in ("--out", "--report", "--plot"):
                assert (tmp_path / value).exists()
    said = result.stdout
    assert "NAMED" in said
    assert "coulomb:velocity" in said
