"""Rows on disk: one CSV per arm, appended run by run, and a JSON file with its settings and time."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.studies.study import Arm, Row, StudyError, Table

LARGEST = 2**30  # characters of a value


class Store:
    """The finished runs of one arm in a directory.

    A row is complete once its line is; a line cut short by a crash is dropped on reading. Raises
    StudyError where the rows on disk were made with other settings or another seed.
    """

    def __init__(self, directory: Path, arm: Arm, seed: int) -> None:
        self.csv = directory / f"{arm.name}.csv"
        self.json = directory / f"{arm.name}.json"
        self.settings = _plain({**arm.settings, "seed": seed})
        self.rows: dict[int, Row] = {}
        self.columns: list[str] = []
        self.wall, self.workers = 0.0, 0
        directory.mkdir(parents=True, exist_ok=True)
        if self.csv.exists() and self.json.exists():
            self._read()

    def _read(self) -> None:
        meta = json.loads(self.json.read_text())
        if meta["settings"] != self.settings:
            changed = sorted(
                key
                for key in {*meta["settings"], *self.settings}
                if meta["settings"].get(key) != self.settings.get(key)
            )
            raise StudyError(
                f"{self.csv} was made with other settings ({', '.join(changed)}); use --fresh to "
                "make its runs again, or another --out"
            )
        self.wall, self.workers = meta["wall_seconds"], meta["workers"]
        with self.csv.open(newline="") as file:
            usual = csv.field_size_limit(LARGEST)  # whole documents are among the values
            try:
                lines = list(csv.reader(file))
            finally:
                csv.field_size_limit(usual)  # it holds for the whole process
        if not lines:
            return
        self.columns = lines[0]
        for line in lines[1:]:
            if len(line) == len(self.columns):
                row: Row = dict(zip(self.columns, line, strict=True))
                self.rows[int(row["run"])] = row
        self.sort()

    def add(self, run: int, row: Row) -> None:
        """Append a finished run."""
        full: Row = {"run": str(run), **{key: _text(value) for key, value in row.items()}}
        new = not self.columns
        if new:
            self.columns = list(full)
        if list(full) != self.columns:
            raise StudyError(f"run {run} has columns {list(full)}; {self.csv} has {self.columns}")
        self.rows[run] = full
        with self.csv.open("w" if new else "a", newline="") as file:
            out = csv.writer(file, lineterminator="\n")
            if new:
                out.writerow(self.columns)
            out.writerow(full.values())

    def spend(self, seconds: float, workers: int) -> None:
        """Record wall time spent on this arm."""
        self.wall += seconds
        self.workers = workers
        meta = {
            "settings": self.settings,
            "wall_seconds": round(self.wall, 1),
            "workers": self.workers,
        }
        self.json.write_text(json.dumps(meta, indent=2, sort_keys=True) + "\n")

    def sort(self) -> None:
        """Write the rows in the order of their runs."""
        if not self.columns:
            return
        partial = self.csv.with_suffix(".part")
        with partial.open("w", newline="") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(self.columns)
            out.writerows(self.rows[run].values() for run in sorted(self.rows))
        partial.replace(self.csv)

    def clear(self) -> None:
        """Forget every run."""
        self.rows, self.columns, self.wall = {}, [], 0.0

    def table(self) -> Table:
        """What there is, sorted by run."""
        rows = [self.rows[run] for run in sorted(self.rows)]
        return Table(rows, self.settings, self.wall, self.workers)


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """As JSON gives it back, so that settings can be compared with those on disk."""
    plain: dict[str, Any] = json.loads(json.dumps(dict(settings)))
    return plain
