"""``python -m tests.studies.foreign.dev --cells room:clean,pendulum:drag --n 3``: a few series, quickly.

Other seeds than those of the benchmark; one line per series: verdict, names, the truth's likelihood ratio,
seconds.
"""

from __future__ import annotations

import argparse

from tests.studies.foreign.cells import cell_of, clean, inside, unlisted
from tests.studies.foreign.runs import DEVELOPMENT, row_of
from tests.studies.study import Row


def main(arguments: list[str] | None = None) -> None:
    """Diagnose some series of some cells."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.foreign.dev")
    parser.add_argument("--cells", default="", help="system:fault[@level],...; default: list them")
    parser.add_argument("--n", type=int, default=1, help="series of each")
    parser.add_argument("--first", type=int, default=0, help="number of the first series")
    parser.add_argument("--twin", action="store_true", help="in other units, too")
    options = parser.parse_args(arguments)
    if not options.cells:
        for euler in (False, True):
            for cell in (*clean(euler), *inside(euler), *unlisted(euler)):
                print(cell.name, cell.hidden, sep="  ")
        return
    for text in options.cells.split(","):
        cell = cell_of(text)
        for run in range(options.first, options.first + options.n):
            print(cell.name, run, line(row_of(cell, [DEVELOPMENT, run], options.twin)), flush=True)


def line(row: Row) -> str:
    """A row in a line."""
    parts = [f"{row['verdict']}: {row['causes'] or '-'}"]
    if row["set"] != row["causes"]:
        parts.append(f"set {row['set']}")
    if row["hidden"] and row["oracle"]:
        parts.append(f"truth LR {float(row['ratio_truth']):.0f}, oracle {row['oracle']}")
    if row["twin"]:
        parts.append(f"twin {row['twin']}")
    parts.append(f"p {float(row['p_value']):.3g}, {float(row['seconds']):.1f} s")
    if row["note"]:
        parts.append(str(row["note"]))
    return "; ".join(parts)


if __name__ == "__main__":
    main()
