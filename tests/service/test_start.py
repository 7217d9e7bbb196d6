"""A service that cannot start says so in one sentence, and leaves nothing running."""

import os
import sqlite3
import stat
import subprocess
import sys

import pytest

from service.settings import Settings
from service.store import Store

NOBODY = "postgresql+psycopg://u:secret@127.0.0.1:1/x"


def corrupt(folder):
    (folder / "rbps.sqlite").write_bytes(b"no database at all\n" * 1000)
    return "the store sqlite:///.*rbps.sqlite cannot be used: file is not a database"


def locked_away(folder):
    Store(Settings(state_dir=folder).store_url).close()
    with sqlite3.connect(folder / "rbps.sqlite") as sql:
        sql.execute(
            "CREATE TRIGGER no BEFORE INSERT ON pulse BEGIN SELECT RAISE(ABORT, 'read-only'); END"
        )
    return "the store sqlite:///.*rbps.sqlite cannot be used: read-only"


def a_folder(folder):
    (folder / "rbps.sqlite").mkdir()
    return "the store sqlite:///.*rbps.sqlite cannot be used: unable to open database file"


SLOW = pytest.mark.slow  # each starts a process


@pytest.mark.long
@pytest.mark.parametrize(
    "spoil",
    [pytest.param(corrupt, marks=SLOW), locked_away, pytest.param(a_folder, marks=SLOW)],
)
def test_a_store_that_cannot_be_used(tmp_path, spoil, match):
    match(spoil(tmp_path), started(tmp_path))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("PORT", "99999", "setting port = 99999; it must be 0 to 65535"),
        pytest.param("PORT", "x", "RBPS_PORT='x' is not of type int", marks=SLOW),
        pytest.param("STATE_DIR", "/dev/null", "/dev/null", marks=SLOW),
        pytest.param("KEYS_FILE", "/none", "No such file or directory: '/none'", marks=SLOW),
        pytest.param("DATABASE_URL", "nonsense", "Could not parse SQLAlchemy URL", marks=SLOW),
        (
            "DATABASE_URL",
            "postgresql+psycopg://u:secret@127.0.0.1:1/x",
            r"the store .*\*\*\*@127.*cannot be used",
        ),
    ],
)
def test_settings_that_cannot_be_used(tmp_path, match, name, value, words):
    said = started(tmp_path, **{f"RBPS_{name}": value})
    match(words, said)
    assert "secret" not in said


def started(folder, **env):
    """What it says."""
    values = {"RBPS_STATE_DIR": str(folder), "RBPS_PORT": "0"} | env
    ended = subprocess.run(
        [sys.executable, "-m", "service"],
        env=os.environ | values,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 1
    assert ended.stdout == ""
    (line,) = ended.stderr.strip().splitlines()
    return line


@pytest.fixture
def match():
    import re

    def check(pattern, text):
        assert text.startswith("rbps: ")
        assert re.search(pattern, text), text

    return check


def test_the_store_is_its_owner_s_alone(tmp_path):
    before = os.umask(0o022)
    try:
        store = Store(Settings(state_dir=tmp_path / "new").store_url)
        store.create("simulate", "m", {}, 1)
        files = [*(tmp_path / "new").iterdir()]
        assert len(files) == 4  # with its journal and the reserve
        for file in (tmp_path / "new", *files):
            assert stat.S_IMODE(file.stat().st_mode) & 0o077 == 0, file
        store.close()
    finally:
        os.umask(before)


def test_an_old_store_becomes_its_owner_s_alone(tmp_path):
    """Earlier versions made files that others could read; a killed service leaves the journal's."""
    url = Settings(state_dir=tmp_path).store_url
    old = Store(url)
    made = old.create("simulate", "m", {}, 1)
    files = [*tmp_path.iterdir()]
    assert len(files) == 4
    for file in files:
        file.chmod(0o644)
    store = Store(url)
    assert store.job(made) is not None
    for file in files:
        assert stat.S_IMODE(file.stat().st_mode) == 0o600, file
    store.close()
    old.close()
