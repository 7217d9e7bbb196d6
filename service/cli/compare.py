"""``rbps compare``: two results that were written with --out, side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from engine import words
from engine.errors import OptionError
from engine.presentation.report import comparison_html, comparison_notes
from engine.presentation.two_results import compare_results, likelihood_difference
from service import strict_json
from service.cli.ending import wrong
from service.cli.files import json_object
from service.cli.outputs import output_path, say_written

COLUMNS = 5  # what it is, both results, their difference, its unit


def show(one: Path, other: Path, report: Path | None, as_json: bool) -> None:
    """Print the comparison; write the report where one is asked for."""
    output_path("--report", report, (".html", ".htm"))
    otherwise = "this is not a result written with --out"
    documents = [json_object(path, otherwise) for path in (one, other)]
    names = [
        document.get("name") or path.stem
        for document, path in zip(documents, (one, other), strict=True)
    ]
    if names[0] == names[1]:
        names = [f"{name} ({path})" for name, path in zip(names, (one, other), strict=True)]
    try:
        found = compare_results(*documents)
    except OptionError as error:
        raise wrong(str(error)) from None
    if report is not None:
        about = {name: str(path) for name, path in zip(names, (one, other), strict=True)}
        report.write_text(comparison_html(found, names, about), encoding="utf-8")
    if as_json:
        print(strict_json.dumps({"names": names, **found}))
        return
    print("\n".join(_lines(found, names)))
    say_written([str(report)] if report is not None else [])


def _lines(c: dict[str, Any], names: Sequence[str]) -> Iterator[str]:
    """A table whose columns are as wide as what is in them, and the notes."""
    rows = [(*row, *[""] * (COLUMNS - len(row))) for row in _rows(c, names)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(
            f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)
        ).rstrip()
    yield from comparison_notes(c, names)


def _rows(c: dict[str, Any], names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    yield "", *names, "difference"
    yield "model", *c["models"]
    yield "outcome", *(one or "" for one in c["outcome"])
    for row in c["parameters"]:
        cells = [
            ""
            if value is None
            else f"{words.number(value, 4)}, no influence"
            if silent
            else _estimate(value, error, held)
            for value, error, held, silent in zip(
                row["values"], row["standard_errors"], row["held"], row["silent"], strict=True
            )
        ]
        difference = "" if row["difference"] is None else words.number(row["difference"], 3)
        if row["in_errors"] is not None:
            difference += f" ({words.number(row['in_errors'], 2)} standard errors)"
        yield row["name"], *cells, difference, words.tidy(row["unit"])
    if any(c["log_likelihood"]):
        gained = likelihood_difference(c)
        cells = [_likelihood(one) for one in c["log_likelihood"]]
        yield "log-likelihood", *cells, "" if gained is None else _plus_minus(*gained)
    held = [{o["output"]: o for o in (one or {}).get("outputs", ())} for one in c["held_out"]]
    for output in dict.fromkeys([*held[0], *held[1]]):
        errors = [each[output]["rmse"] if output in each else None for each in held]
        lost = ["diverges" if output in each else "" for each in held]
        yield from _numbers(f"held-out error of {output}", errors, c["same_held_out"], lost)
    densities = [(one or {}).get("log_density") for one in c["held_out"]]
    yield from _numbers("held-out log-density", densities, c["same_held_out"])


def _numbers(
    title: str, pair: Sequence[float | None], same: bool | None, missing: Sequence[str] = ("", "")
) -> Iterator[tuple[str, ...]]:
    """A line of two numbers; ``missing`` is said in place of one that is not there."""
    first, second = pair
    if first is None and second is None and not any(missing):
        return
    both = first is not None and second is not None and same
    difference = words.number((second or 0.0) - (first or 0.0), 4) if both else ""
    cells = [
        said if one is None else words.number(one, 6)
        for one, said in zip(pair, missing, strict=True)
    ]
    yield title, *cells, difference


def _estimate(value: float, error: float | None, held: bool) -> str:
    return f"{words.number(value, 5)} held" if held else _plus_minus(value, error, 5)


def _likelihood(one: dict[str, Any] | None) -> str:
    if one is None or one["value"] is None:
        return ""
    return _plus_minus(one["value"], one.get("standard_error") or None, 6)


def _plus_minus(value: float, error: float | None, most: int = 4) -> str:
    shown = words.number(value, words.digits(value, error, most))
    return shown + ("" if error is None else f" +- {words.number(error, 2)}")
