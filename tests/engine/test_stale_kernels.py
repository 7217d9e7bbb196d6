"""A kernel is compiled anew when any kernel's source has changed, not only its own."""

import os
from pathlib import Path

import pytest

from engine.kernels.gaussian import psd_cholesky
from engine.kernels.stale import STAMP, discard_stale


@pytest.fixture
def folders(tmp_path):
    """Two sources, and code that was compiled from others."""
    sources, cache = tmp_path / "kernels", tmp_path / "kernels" / "__pycache__"
    cache.mkdir(parents=True)
    for name in ("one", "other"):
        (sources / f"{name}.py").write_text(f"# {name}\n")
    (cache / "one.f-3.py311.nbi").write_bytes(b"")
    (cache / "one.f-3.py311.1.nbc").write_bytes(b"")
    (cache / "one.cpython-311.pyc").write_bytes(b"")
    return sources, cache


def test_code_of_other_sources_goes_and_nothing_else(folders):
    sources, cache = folders
    assert discard_stale(*folders)
    assert {path.name for path in cache.iterdir()} == {"one.cpython-311.pyc", STAMP}
    (cache / "one.f-3.py311.nbi").write_bytes(b"")
    assert not discard_stale(*folders)
    assert (cache / "one.f-3.py311.nbi").exists()
    (sources / "other.py").write_text("# changed\n")
    assert discard_stale(*folders)
    assert not (cache / "one.f-3.py311.nbi").exists()


def test_a_folder_that_does_not_exist_yet_is_made(folders, tmp_path):
    sources, _ = folders
    assert not discard_stale(sources, tmp_path / "elsewhere" / "numba")
    assert (tmp_path / "elsewhere" / "numba" / STAMP).is_file()


def test_where_it_cannot_be_removed_it_says_so(folders, monkeypatch):
    def refused(self, missing_ok=False):
        raise PermissionError("read-only")

    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.warns(UserWarning, match="another version .* NUMBA_CACHE_DIR"):
        discard_stale(*folders)


def test_the_code_that_is_used_here_is_of_these_sources():
    assert os.path.exists(os.path.join(psd_cholesky.stats.cache_path, STAMP))
