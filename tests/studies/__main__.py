"""``python -m tests.studies NAME ...``: make tables and figures of the source documents."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.studies.catalogue import ALIASES, DOCUMENTS, STUDIES
from tests.studies.runner import make_study
from tests.studies.study import StudyError
from tests.studies.times import times

RESULTS = Path("tests/benchmarks/results")


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line and make the studies it names; 2 for a study that cannot be made."""
    names = "\n".join(f"  {name:<18} {study.title}" for name, study in STUDIES.items())
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies",
        description="Make tables and figures of the source documents. Finished runs are kept, and "
        "an interrupted study goes on where it stopped.",
        epilog=f"studies:\n{names}\n  all                every table and figure of the source documents",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="+", metavar="NAME", help="a study, see below")
    parser.add_argument("--runs", type=int, help="a short version: this many runs of everything")
    parser.add_argument("--workers", type=int, help="processes (default: all cores)")
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers (default: 0)")
    parser.add_argument("--out", type=Path, default=RESULTS, help=f"directory (default: {RESULTS})")
    parser.add_argument("--fresh", action="store_true", help="make every run again")
    parser.add_argument(
        "--report", action="store_true", help="only write table and plot of the runs there are"
    )
    options = parser.parse_args(arguments)
    for field in ("runs", "workers"):
        value = getattr(options, field)
        if value is not None and value < 1:
            parser.error(f"--{field} {value}: at least 1 is needed")
    names_asked = list(DOCUMENTS) if options.names == ["all"] else options.names
    wanted = list(dict.fromkeys(ALIASES.get(name, name) for name in names_asked))
    unknown = [name for name in wanted if name not in STUDIES]
    if unknown:
        parser.error(f"no study {', '.join(unknown)}; there are {', '.join([*STUDIES, *ALIASES])}")
    for name in wanted:
        try:
            text = make_study(
                STUDIES[name],
                options.out,
                0 if options.report else options.runs,
                options.seed,
                options.workers,
                options.fresh,
            )
        except StudyError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 2
        print(text)
    if options.names == ["all"]:
        text = times([STUDIES[name] for name in wanted], options.out, options.seed)
        (options.out / "times.md").write_text(text)
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
