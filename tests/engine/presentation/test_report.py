"""Reports as files: whole, alone, escaped, and drawing what the document says."""

from __future__ import annotations

import copy
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose import diagnose
from engine.errors import OptionError
from engine.models.linear_2 import MODEL as LINEAR
from engine.models.local_level import MODEL as LEVEL
from engine.presentation.report import OnPage, make_report, report_html, write_report
from engine.presentation.report.chart import Chart, Ranking, Trace
from engine.presentation.report.html import tag
from engine.presentation.report.parts import measured, plus_minus, pretty
from engine.presentation.report.svg import Axis, svg, svg_element
from engine.simulation.simulate import simulate
from tests.engine.clear_step import clear_flows

EVIL = '<script>alert("1")</script>'
VOID = {"meta"}


class Outline(HTMLParser):
    """Elements with their attributes; fails where one is not closed in its place."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.words = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, name, attributes):
        self.elements.append((name, dict(attributes)))
        if name not in VOID:
            self.open.append(name)

    def handle_endtag(self, name):
        assert self.open.pop() == name

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())

    def all(self, name):
        return [attributes for element, attributes in self.elements if element == name]


def check_alone(text):
    """Nothing from anywhere else, nothing that runs."""
    assert not re.search(r"https?://|@import|url\(", text)
    page = Outline(text)
    assert not page.all("script") + page.all("link") + page.all("img") + page.all("iframe")
    for _, attributes in page.elements:
        assert not any(name.startswith("on") for name in attributes)
        assert attributes.get("href", "#").startswith("#")
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert all(link["href"][1:] in ids for link in page.all("a"))
    return page


@pytest.fixture(scope="module")
def diagnosis(nile_diagnosis):
    return nile_diagnosis.to_dict()


@pytest.fixture(scope="module")
def estimate():
    series = simulate(LINEAR, None, 120, np.random.default_rng(2)).series
    y = series.y.copy()
    y[30:35] = np.nan
    found = engine.rts_em(LINEAR, Series(y), {"theta": 0.3}, n_iterations=30)
    errors = engine.standard_errors(LINEAR, found.theta, Series(y), exact=True)
    return engine.examine(found, Series(y), errors, n_particles=20)


# ---- whole reports ----------------------------------------------------------------------------


@pytest.mark.long
def test_diagnosis_in_one_file(diagnosis, tmp_path):
    file = write_report(diagnosis, tmp_path / "out.html", {"data": "nile.csv"})
    page = check_alone(file.read_text("utf-8"))
    assert [s["id"] for s in page.all("section")] == [
        "wrong", "cause", "extension", "gain", "testable", "notes",
    ]  # fmt: skip
    text = page.text
    first = text[: text.index("1. What is wrong")]
    assert "named" in first
    size = diagnosis["causes"][0]["size"]  # the verdict is understood from the top
    assert f"Step of the reading flow ({size:.1f} ±" in first
    assert "1899" in first
    assert diagnosis["over_horizon"]["sentence"] in text
    assert "Over the horizon" in text
    decision = diagnosis["gain"]["decision"]
    assert decision["outcome"] == "adopted"
    assert decision["in_short"] in first
    assert decision["in_full"] in text
    o = diagnosis["gain"]["outputs"][0]
    assert f"{o['rmse_before']:.3g} → {o['rmse_after']:.3g} × 10⁸ m³" in first
    for said in ("Look-alikes", "ruled out", "Error budget", "Before", "After", "nile.csv"):
        assert said in text, said
    for figure in ("Free-run simulation of flow", "Held-out data", "Autocorrelation", "by time"):
        assert any(figure in svg["aria-label"] for svg in page.all("svg")), figure


@pytest.mark.long
def test_estimate_in_one_file(estimate, tmp_path):
    page = check_alone(estimate.report(tmp_path / "out.html").read_text("utf-8"))
    ids = [s["id"] for s in page.all("section")]
    assert ids == ["convergence", "states-0", "simulation-0", "residuals-0", "where-0", "model"]
    found = estimate.document["estimate"]["theta"]
    low, high = found["interval"]
    assert f"{found['value']:.5g}" in page.text
    assert f"{low:.4g} to {high:.4g}" in page.text
    labels = [svg["aria-label"] for svg in page.all("svg")]
    for figure in ("theta:", "a: smoothed", "z: smoothed", "Free-run", "One-step", "Quantiles"):
        assert any(figure in label for label in labels), figure


@pytest.mark.long
def test_library_and_service_documents_give_the_same_report(diagnosis, estimate):
    assert report_html({"diagnosis": diagnosis, "message": ""}) == report_html(diagnosis)
    stored = json.loads(json.dumps(estimate.to_dict()))
    assert report_html(stored) == report_html(estimate.to_dict())


def test_a_diagnosis_of_an_earlier_version_says_so(diagnosis):
    old = {key: value for key, value in diagnosis.items() if key != "channels"}
    with pytest.raises(OptionError, match="run it again"):
        report_html(old)


def test_an_unknown_cause_is_no_name(diagnosis):
    document = copy.deepcopy(diagnosis)
    document["verdict"], document["sentence"] = "unknown", "None explains it."
    t = document["gain"]["curves"]["t"]
    document["unnamed"] = {
        "target": "level", "unit": "1e8 m^3/s", "sentence": "A force of 3 x 1e8 m^3 +- 1 acts.",
        "curves": {"t": t, "mean": [1.0] * len(t), "standard_deviation": [0.5] * len(t)},
    }  # fmt: skip
    page = check_alone(report_html(document))
    first = page.text[: page.text.index("1. What is wrong")]
    assert "A force of 3 × 10⁸ m³ ± 1 acts." in first
    assert "Nearest names: Step of the reading flow" in first
    assert any("unnamed force on level" in svg["aria-label"] for svg in page.all("svg"))
    # what is known comes first, then that it has no name, then the names, small
    places = [first.index(text) for text in ("A force of", "None explains it", "Nearest names")]
    assert places == sorted(places)
    without = document | {"unnamed": None}
    first = check_alone(report_html(without)).text.partition("1. What is wrong")[0]
    fit = document["symptoms"]["one_step"]["fits"][0]
    assert f"The predicted flow is {fit['rmse']:.3g}" in first
    assert "the curve below shows it" in first


def test_the_first_picture_is_measured_before_and_after_on_held_out_data(diagnosis):
    page = check_alone(report_html(diagnosis))
    labels = [svg["aria-label"] for svg in page.all("svg")]
    assert labels[0].startswith("Held-out data and simulation of flow")
    for words in ("measured, held out", "simulated before the", "simulated after the"):
        assert words in page.text.partition("1. What is wrong")[0]
    without = copy.deepcopy(diagnosis)
    without["gain"] = None
    labels = [svg["aria-label"] for svg in check_alone(report_html(without)).all("svg")]
    assert labels[0].startswith("Free-run simulation of flow and the data")


def test_what_noise_has_room_for_does_not_read_as_fine(diagnosis):
    document = copy.deepcopy(diagnosis)
    (fit,) = document["symptoms"]["free_run"]["fits"]
    fit["rmse"], fit["expected_rmse"] = 0.181, 0.46
    page = check_alone(report_html(document)).text
    assert "is expected" not in page
    assert "alone would give 0.46 × 10⁸ m³, so an error of the model can hide in it" in page
    fit["rmse"] = 0.61
    assert "alone would give 0.46 × 10⁸ m³ only" in check_alone(report_html(document)).text


def test_nothing_found_is_said_plainly():
    series = simulate(LINEAR, None, 200, np.random.default_rng(8)).series
    found = diagnose(LINEAR, series, effects=["bias", "force"], seed=1)
    assert (found.verdict.value, found.causes) == ("nothing", ())
    text = check_alone(report_html(found.to_dict())).text
    assert "NOTHING" in text.partition("1. What is wrong")[0].upper()
    assert "the model stays as it is" in text
    assert "nothing is gained or lost" in text


def test_states_and_simulations():
    axis = {"t": [0.0, 1.0, 2.0]}
    states = {
        "states": {
            "units": {"a": "V"},
            "series": [
                axis | {"mean": {"a": [1, 2, 3]}, "standard_deviation": {"a": [1, 1, None]}}
            ],
        }
    }
    page = check_alone(report_html(states))
    assert page.all("svg")[0]["aria-label"].startswith("a: smoothed mean")
    simulated = {
        "simulation": {
            "units": {"y": "V", "a": ""},
            "series": [
                axis | {"y": {"y": [1, 2, 3]}, "states": {"a": [0, 1, 0]}, "rmse": 0.25,
                        "rmse_by_output": {"y": 0.25},
                        "measured": {"y": [1.0, None, 2.5]}},
            ],
        }
    }  # fmt: skip
    page = check_alone(report_html(simulated))
    assert "Wrong by 0.25 V rms" in page.text
    assert "measured" in page.all("svg")[0]["aria-label"]
    with pytest.raises(OptionError, match="no estimate"):
        report_html({"message": "none"})


# ---- what others wrote ------------------------------------------------------------------------


def test_how_files_were_read_is_in_the_report_of_a_diagnosis(diagnosis):
    """As a job's result has it, beside the diagnosis; the notes of this one stay as they were."""
    before = list(diagnosis["notes"])
    page = check_alone(
        report_html({"diagnosis": diagnosis, "notes": ["a step of 1 s is assumed"]}, {})
    )
    assert "a step of 1 s is assumed" in page.text
    assert diagnosis["notes"] == before


@pytest.mark.long
def test_names_are_escaped(diagnosis):
    names = {"outputs": {EVIL: EVIL}, "linear": {f"{EVIL} of a state": "<b>"}, "reference": {}}
    evil = replace(LEVEL, description=EVIL, **names)
    found = diagnose(
        evil,
        clear_flows(),
        effects=["bias", "step", "ramp"],
        seed=1,
        theta={"q": 1500.0, "r": 15000.0},
    ).to_dict()
    found["notes"].append(EVIL)
    page = check_alone(report_html(found, {EVIL: EVIL}))
    assert EVIL in page.text
    draw = OnPage()
    parts = make_report(found, draw)
    for html in (parts.summary, *(s.body for s in parts.sections)):
        assert "<script" not in html
        Outline(html)
    assert (
        draw.charts[0]["title"].count(EVIL) == 1
    )  # as data, which the page's script shows as text


def test_messages_are_escaped(estimate):
    document = copy.deepcopy(estimate.to_dict())
    document["message"] = document["model"]["name"] = EVIL
    document["starts"] = [{"start": {EVIL: 1.0}, "outcome": EVIL, "message": EVIL}]
    document["examination"]["series"].append({"problem": EVIL})
    check_alone(report_html(document))


def test_attributes_are_escaped():
    assert tag("i", "<", title='"><b>', class_=None) == '<i title="&quot;&gt;&lt;b&gt;">&lt;</i>'


# ---- charts -----------------------------------------------------------------------------------


def numbers(path):
    return [float(x) for x in re.findall(r"-?[\d.]+", path)]


def paths(chart, width=520, height=250):
    page = Outline(svg(chart, width, height))
    return {p["class"]: p["d"] for p in page.all("path")}


def test_a_curve_is_where_its_values_are():
    chart = Chart("c", "x", "y", [0, 1, 2, 3, 4], (Trace("one", [0.0, 1.0, None, 0.5, 1.0]),))
    d = paths(chart)["curve r-model"]
    pieces = [p for p in d.split("M") if p]
    assert len(pieces) == 2  # the gap is a gap
    x = [numbers(p)[::2] for p in pieces]
    y = [numbers(p)[1::2] for p in pieces]
    assert x[1][1] - x[1][0] == pytest.approx(x[0][1] - x[0][0], abs=0.2)
    assert y[0][0] > y[1][0] > y[1][1] == y[0][1]  # downwards on the screen
    assert y[1][0] == pytest.approx(0.5 * (y[0][0] + y[0][1]), abs=0.2)


def test_extremes_of_long_curves_are_drawn():
    values = np.zeros(100_000)
    values[40_123], values[70_321] = 5.0, -3.0
    chart = Chart("c", "x", "y", list(range(100_000)), (Trace("one", values.tolist()),))
    d = paths(chart)["curve r-model"]
    assert len(d) < 30_000
    y = numbers(d)[1::2]
    level = y[0]
    assert (level - min(y)) / (max(y) - level) == pytest.approx(5.0 / 3.0, rel=0.02)
    assert 1000 < len(chart.thinned().x) <= 2400


def test_bands_and_bars():
    band = Trace("b", [1.0, 1.0], band=([0.0, 0.0], [2.0, 2.0]))
    d = numbers(paths(Chart("c", "x", "y", [0, 1], (band,)))["band r-model"])
    assert max(d[1::2]) > min(d[1::2])
    bars = Chart("c", "x", "y", [1, 2], (Trace("b", [0.5, -0.25], "bars", width=[0.3, 0.3]),))
    rects = Outline(svg(bars, 520, 250)).all("rect")
    heights = [float(r["height"]) for r in rects]
    assert heights[0] == pytest.approx(2.0 * heights[1], rel=0.02)
    assert float(rects[1]["y"]) == pytest.approx(float(rects[0]["y"]) + heights[0], abs=0.2)
    ranked = Outline(
        svg_element(Ranking("t", "score", [("one", 10.0, "after"), ("two", -2.0, "data")], 4.0))
    )
    widths = [float(r["width"]) for r in ranked.all("rect")]
    assert widths[0] == pytest.approx(5.0 * widths[1], rel=0.02)


@pytest.mark.parametrize(
    "values", [[], [None, None], [1.0, 1.0], [float("nan"), 2.0], [1e-300, 1e300], [0.0, 1e-9]]
)
@pytest.mark.parametrize("log", ["", "xy"])
def test_any_values_make_a_chart(values, log):
    chart = Chart("c", "x", "y", list(range(1, len(values) + 1)), (Trace("t", values),), log=log)
    text = svg_element(chart)
    Outline(text)
    assert "nan" not in text
    assert "inf" not in text


def test_ticks_are_round_and_inside():
    assert Axis(0.0, 10.0, 0.0, 100.0).ticks(5) == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert Axis(0.012, 0.19, 0.0, 1.0, log=True).ticks(5) == [0.02, 0.05, 0.1]
    assert Axis(0.5, 2e4, 0.0, 1.0, log=True).ticks(5) == pytest.approx([1, 10, 100, 1e3, 1e4])
    for low, high in ((-3.7e-9, 8.1e-9), (1e6, 1e6 + 3), (-5e8, 7e8)):
        ticks = Axis(low, high, 0.0, 1.0).ticks(5)
        assert 2 <= len(ticks) <= 8
        assert all(low <= tick <= high for tick in ticks)


def test_units_as_they_are_printed():
    assert pretty("1e8 m^3") == "10⁸ m³"
    assert pretty("V^0.5/s") == "V^0.5/s"
    assert pretty("N*s/m") == "N s/m"
    assert measured(256.4, "1e8 m^3") == "256 × 10⁸ m³"
    assert plus_minus(0.5234, 0.0312, "N") == "0.5234 ± 0.031 N"
    assert plus_minus(0.3874, 0.03, "1/rad") == "0.3874 ± 0.03 1/rad"
    assert measured(2.0, "1/s") == "2 1/s"
    assert measured(2.0, "100 m") == "2 × 100 m"
    assert plus_minus(256.4, 12.0, "1e8 m^3") == "(256.4 ± 12) × 10⁸ m³"
    assert plus_minus(2.0, None, "1") == "2"


def test_other_starts_are_drawn_beside_the_one_taken(estimate):
    document = copy.deepcopy(estimate.to_dict())
    own = document["trace"]["theta"]["theta"]

    def start(first, n):
        trace = {"iteration": list(range(n)), "theta": {"theta": [first + k for k in range(n)]}}
        return {"start": {"theta": first}, "outcome": "converged", "message": "", "trace": trace}

    document["starts"] = [start(own[0], len(own)), start(5.0, 3), start(6.0, 40)]
    draw = OnPage()
    make_report(document, draw)
    theta = draw.charts[0]
    assert theta["x"] == list(range(40))
    shown = {one["label"]: one["y"] for one in theta["series"]}
    assert shown["start 2"][:4] == [5.0, 6.0, 7.0, None]
    assert shown["iterate"][: len(own)] == own
    assert shown["iterate"][len(own) :] == [None] * (40 - len(own))
    document["starts"] = [start(float(k), 30) for k in range(1, 12)]
    draw = OnPage()
    make_report(document, draw)
    (many,) = (one for one in draw.charts[0]["series"] if "range" in one["label"])
    assert many["y"][0] == 6.0
    assert (many["band"][0][29], many["band"][1][29]) == (30.0, 40.0)
