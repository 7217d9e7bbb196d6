"""Fixtures for all tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

DATA = Path(os.environ.get("RBPS_DATA") or Path(__file__).parents[2] / "shared" / "data")


@pytest.fixture
def measured_data() -> Callable[[str], Path]:
    """Folder of a measured data set by name; skips the test where the data are not there."""

    def find(name: str) -> Path:
        folder = DATA / name
        if not folder.is_dir():
            pytest.skip(
                f"measured data '{name}' not found; set RBPS_DATA to the folder of data sets"
            )
        return folder

    return find
