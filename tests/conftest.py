"""Fixtures for all tests."""

from __future__ import annotations

import csv
import locale
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DATA = Path(os.environ.get("MEASURED_DATA") or Path(__file__).parents[2] / "shared" / "data")

# A shell has its background jobs ignore Ctrl-C, and the services that tests start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def measured_data() -> Callable[[str], Path]:
    """Folder of a measured data set by name; skips the test where the data are not there."""

    def find(name: str) -> Path:
        folder = DATA / name
        if not folder.is_dir():
            pytest.skip(
                f"measured data '{name}' not found; set MEASURED_DATA to the folder of data sets"
            )
        return folder

    return find


@pytest.fixture(scope="session")
def nile_diagnosis() -> Any:
    """A diagnosis of the Nile's flows, which several tests look at and none changes."""
    import engine
    from engine.data import nile

    effects = ["step", "pulse"]
    return engine.diagnose(engine.get_model("local-level"), nile(), effects=effects, seed=1)


@pytest.fixture(scope="session")
def clear_diagnosis() -> Any:
    """Likewise of flows whose step is clear, in a quarter of the time."""
    import engine
    from tests.engine.clear_step import clear_flows

    effects = ["step", "pulse"]
    return engine.diagnose(engine.get_model("local-level"), clear_flows(), effects=effects, seed=1)


def of_the_process() -> dict[str, Any]:
    """What holds for the whole process, and so for all tests that come later."""
    # which the service and the studies set for their workers
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    others = ("PYTEST_CURRENT_TEST", "KMP_DUPLICATE_LIB_OK", "KMP_INIT_AT_FORK")  # scikit-learn's
    env = {key: value for key, value in os.environ.items() if key not in (*threads, *others)}
    registry = sys.modules.get("engine.models.registry")
    return {
        "files of models": [[*one] for one in vars(registry._own).values() if one]
        if registry
        else [],
        "environment": env,
        "folder": os.getcwd(),
        "longest cell of a CSV": csv.field_size_limit(),
        "floating-point errors": np.geterr(),
        "print options": np.get_printoptions(),
        "recursion": sys.getrecursionlimit(),
        "locale": locale.setlocale(locale.LC_ALL),
    }


@pytest.fixture(autouse=True)
def no_trace_in_the_process() -> Iterator[None]:
    """Tests pass in any order: none leaves anything changed that holds for the whole process."""
    before = of_the_process()
    yield
    assert of_the_process() == before
