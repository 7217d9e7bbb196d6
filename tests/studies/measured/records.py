"""The records, read from the folder in the environment variable MEASURED_DATA.

Else from ``shared/data`` beside the repository; those that are not there are skipped.
"""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from engine.data import nile
from engine.data.files import read_series
from engine.data.series import Series
from engine.models.registry import get_model
from engine.statespace.model import Array, MixedModel
from tests.studies.measured.models import CELL, SEASONAL, SPRING

DATA = Path(os.environ.get("MEASURED_DATA") or Path(__file__).parents[4] / "shared" / "data")
SETTLED = 50  # rows of a test part from which the first state is estimated, not scored

SILVERBOX_DT = 2**14 / 1e7  # s
SILVERBOX_TEST, SILVERBOX_PLAIN = 65062, 32000
# One step ahead, records nearly free of noise are explained by one patch after the other. Where a search takes
# many minutes one is enough: the free run is asked all the same.
ONCE = {"max_effects": 1}
ONE = "one round one step ahead"
EMPS_THINNED = 40  # samples of 1 ms that become one
BOUCWEN_DT = 1.0 / 750.0  # s
BOUCWEN_PERIOD = 8192  # rows; the first period is not settled
PULSE, CHARGED = 6, 8  # what the tester did: a pulse begins, it ends


@dataclass(frozen=True)
class Data:
    """A model with a record's training part and its test parts, the first of which judges.

    ``settled`` rows of a test part are for its first state; with ``blocks`` there is no other record, and
    blocks left out of the fit judge.
    """

    model: MixedModel
    train: Series
    tests: Mapping[str, Series]
    options: Mapping[str, Any] = field(default_factory=dict)
    settled: int = SETTLED
    blocks: bool = False


@dataclass(frozen=True)
class Record:
    """One record; ``cut`` says which part of it is used, ``unit`` of errors, ``scale`` from the output's."""

    name: str
    folder: str
    load: Callable[[Path], Data]
    cut: str = "all"
    unit: str = ""
    scale: float = 1.0

    @property
    def path(self) -> Path:
        """Where its files are."""
        return DATA / self.folder

    @property
    def there(self) -> bool:
        """Whether they are."""
        return not self.folder or self.path.is_dir()

    @property
    def reason(self) -> str:
        """Why it is skipped, where it is."""
        return f"the folder '{self.folder}' is not among the data; set MEASURED_DATA to where it is"


def _emps(folder: Path) -> Data:
    """The drive, its friction and offset unknown to the model."""
    train, test = (
        read_series(folder / f"{name}.csv", y=["y_m"], u=["u_V"], dt=1e-3).thinned(EMPS_THINNED)
        for name in ("estimation", "test_pulses")
    )
    options = {
        "theta": {"Fc": 0.0, "offset": 0.0},
        "free": ["M", "Fv", "sigma_v", "sigma_load", "sigma_y"],
    }
    return Data(get_model("servo"), train, {"pulses": test}, options)


def _silverbox(folder: Path) -> Data:
    """The excitation is limited in band, so a straight line between its samples is nearer than a stair."""
    record, arrow = (
        read_series(folder / f"{name}.csv", dt=SILVERBOX_DT, hold="foh")
        for name in ("multisine", "arrow")
    )
    tests = {
        "multisine": record.part(SILVERBOX_TEST, len(record)),
        "arrow": arrow,
        "arrow, no extrapolation": arrow.part(0, SILVERBOX_PLAIN),
    }
    start = {"omega": 430.0, "zeta": 0.05, "gain": 1.0, "sigma_v": 10.0, "sigma_y": 1e-3}
    train = record.part(0, SILVERBOX_TEST)
    return Data(get_model("oscillator"), train, tests, {"theta": start})


def _tanks(folder: Path) -> Data:
    train, test = (read_series(folder / f"{part}.csv", dt=4.0) for part in ("estimation", "test"))
    return Data(get_model("tanks"), train, {"test": test})


def _boucwen(folder: Path) -> Data:
    """Steady state, from the second period on; the sweep is the one record that begins at rest."""
    options: dict[str, Any] = {"y": ["y_m"], "u": ["u_N"], "dt": BOUCWEN_DT, "hold": "foh"}
    train = read_series(folder / "estimation_multisine.csv", **options)
    test = read_series(folder / "test_multisine.csv", **options)
    sweep = _gzipped(folder / "test_sinesweep.csv.gz")
    tests = {
        "multisine": test.part(BOUCWEN_PERIOD // 2, BOUCWEN_PERIOD),
        "sweep": Series(sweep[:, 1], sweep[:, 0], dt=BOUCWEN_DT, hold="foh"),
    }
    return Data(SPRING, train.part(BOUCWEN_PERIOD, len(train)), tests, ONCE)


def _gzipped(path: Path) -> Array:
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def _cell(folder: Path) -> Data:
    """One continuous run; readings of even pulses are left out of the fit and judge.

    The discharges between them stay in, as they alone tell the open-circuit voltage at their charges.
    """
    table = np.genfromtxt(folder / "hppc_25C.csv", delimiter=",", names=True)
    step = table["step"].astype(int)
    first = int(np.flatnonzero(step == PULSE)[0])
    step = step[first:]
    t, voltage, current = (table[name][first:] for name in ("t_s", "voltage_V", "current_A"))
    pulse = np.cumsum(np.diff(step == PULSE, prepend=False) & (step == PULSE))
    whole = Series(voltage, current, t=t, y_names=["voltage"], hold="past")
    even = (pulse % 2 == 0) & (step <= CHARGED)
    free = [name for name in CELL.parameter_names if name != "Q"]
    return Data(
        CELL, whole.masked(even), {"even pulses": whole.masked(~even)}, {"free": free, **ONCE}, 0
    )


def _nile(folder: Path) -> Data:
    """There is no other record; what is found in time is judged on blocks left out."""
    return Data(get_model("local-level"), nile(), {}, settled=0, blocks=True)


def _seatbelts(folder: Path) -> Data:
    """The law is not told. It falls into the last fifth, so none is kept back; blocks left out judge."""
    table = np.genfromtxt(folder / "seatbelts.csv", delimiter=",", names=True)
    y, price = np.log(table["drivers_ksi_count"]), np.log(table["petrol_price"])
    whole = Series(y, price, dt=1.0, y_names=["drivers"], u_names=["price"])
    return Data(SEASONAL, whole, {}, {"held_out": 0.0}, settled=0, blocks=True)


RECORDS = {
    record.name: record
    for record in (
        Record("nile", "", _nile, unit="1e8 m^3"),
        Record("seatbelts", "seatbelts", _seatbelts, unit="log"),
        Record("emps", "emps", _emps, f"1 sample in {EMPS_THINNED}", "mm", 1e3),
        Record("silverbox", "silverbox", _silverbox, "all", "mV", 1e3),
        Record(
            "boucwen",
            "boucwen",
            _boucwen,
            f"all but the first period; {ONE}",
            "mm",
            1e3,
        ),
        Record(
            "battery",
            "battery_leaf_hppc",
            _cell,
            f"all from the first pulse on; {ONE}",
            "mV",
            1e3,
        ),
        Record("tanks", "cascaded_tanks", _tanks, "all", "V"),
    )
}
