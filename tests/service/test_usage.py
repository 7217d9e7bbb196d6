"""The command ``python -m service``: its help, and what it refuses."""

from dataclasses import fields

import pytest

from service import __main__
from service.settings import Settings


def test_help_lists_all_settings_and_starts_nothing(monkeypatch, capsys):
    monkeypatch.setattr(__main__, "main", lambda: pytest.fail("it serves"))
    __main__.command(["--help"])
    said = capsys.readouterr().out
    assert said.startswith("usage: python -m service")
    for one in fields(Settings):
        assert f"  RBPS_{one.name.upper()}=" in said
    assert "RBPS_PORT=8000\n" in said
    assert "RBPS_KEYS_FILE=\n" in said


@pytest.mark.parametrize("arguments", [["--prot", "80"], ["serve"], ["--help", "x"]])
def test_unknown_arguments_are_refused(monkeypatch, capsys, arguments):
    monkeypatch.setattr(__main__, "main", lambda: pytest.fail("it serves"))
    with pytest.raises(SystemExit) as ended:
        __main__.command(arguments)
    assert ended.value.code == 2
    assert "unknown argument" in capsys.readouterr().err


def test_without_arguments_it_serves(monkeypatch):
    served = []
    monkeypatch.setattr(__main__, "main", lambda: served.append(True))
    __main__.command([])
    assert served
