"""Reports: one self-contained HTML file from the JSON document of an estimation or a diagnosis.

The input is the document that both the library and the service give: ``Diagnosis.to_dict()``,
``engine.examine(...).to_dict()``, or the body of ``GET /jobs/{id}/results``. A report has no script and no
outside address; its charts are SVG. It opens from disk, prints, and is dark where the reader's system is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from engine.errors import OptionError
from engine.presentation.report.comparison import clocked
from engine.presentation.report.design import design_report
from engine.presentation.report.diagnosis import diagnosis_report
from engine.presentation.report.early import early_report
from engine.presentation.report.estimate import estimate_report, simulation_report, states_report
from engine.presentation.report.html import Html, join, tag
from engine.presentation.report.parts import Document, Drawer, OnPage, Report, Section, facts
from engine.presentation.report.style import RULES, stylesheet
from engine.presentation.report.svg import svg_element
from engine.presentation.report.two_results import comparison_notes, comparison_report

__all__ = [
    "RULES",
    "OnPage",
    "Report",
    "Section",
    "comparison_html",
    "comparison_notes",
    "comparison_report",
    "make_report",
    "report_html",
    "write_report",
]


class Documented(Protocol):
    """A result with a JSON document."""

    def to_dict(self) -> dict[str, Any]:
        """The JSON document."""


def write_report(
    result: Documented | Document, path: str | Path, about: Mapping[str, object] | None = None
) -> Path:
    """Write a report as one HTML file.

    Parameters
    ----------
    result : Diagnosis, Examination or mapping
        Also the JSON document of either, or of the service's results, {"diagnosis": {...}} or
        {"estimate": {...}, ...}.
    path : str or Path
        The file to write.
    about : mapping, optional
        Rows to show at its end, such as {"data": "flows.csv", "seed": 1}.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    OptionError
        The document holds nothing to report.
    """
    document = result if isinstance(result, Mapping) else result.to_dict()
    file = Path(path)
    file.write_text(report_html(document, about), encoding="utf-8")
    return file


def report_html(document: Document, about: Mapping[str, object] | None = None) -> str:
    """The text of the file."""
    return _file(make_report(document), about or {})


def comparison_html(
    compared: Document, names: Sequence[str], about: Mapping[str, object] | None = None
) -> str:
    """The text of a file on two results, from :func:`engine.presentation.two_results.compare_results`."""
    return _file(comparison_report(compared, names, svg_element), about or {})


def _file(report: Report, about: Mapping[str, object]) -> str:
    end = [facts(about.items()), "Made by rbps. The figures are those of the JSON document."]
    head = tag(
        "head",
        Html('<meta charset="utf-8">'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        tag("title", report.title),
        tag("style", Html(stylesheet())),
    )
    sections = [tag("section", tag("h2", s.title), s.body, id=s.id) for s in report.sections]
    main = tag("main", tag("h1", report.title), report.summary, *sections)
    body = tag("body", main, tag("footer", join(end)))
    return f"<!doctype html>\n{tag('html', head, body, lang='en')}\n"


def make_report(document: Document, draw: Drawer = svg_element) -> Report:
    """The report's parts; ``draw`` makes its charts."""
    if document.get("design"):
        document = document["design"]
        return design_report(document, clocked(draw, document.get("time_unit")))
    if document.get("diagnosis"):
        read = document.get("notes") or []  # how its files were
        document = document["diagnosis"]
        if "notes" in document:  # of one that has ended
            document = {**document, "notes": [*read, *document["notes"]]}
    if document.get("early"):
        read = document.get("notes") or []
        document = document["early"]
        return early_report(document, clocked(draw, document["time_unit"]), read)
    draw = clocked(draw, document.get("time_unit"))
    if document.get("verdict"):
        if "channels" not in document:
            raise OptionError(
                "this diagnosis was stored by an earlier version, without its curves; run it again",
                "result",
            )
        return diagnosis_report(document, draw)
    if document.get("estimate"):
        return estimate_report(document, draw)
    if document.get("simulation"):
        return simulation_report(document, draw)
    if document.get("states"):
        return states_report(document, draw)
    raise OptionError("there is no estimate, diagnosis, simulation or state to report", "result")
