"""The job kind design: accepted, computed, refused by the field."""

import json

import numpy as np
import pytest

import engine
from engine.design.candidates import ALARM
from service import designs, diagnoses, strict_json, validation
from service.examples import EXAMPLES

REQUEST = EXAMPLES["design"]["value"]


def _with(**options):
    return REQUEST | {"options": REQUEST["options"] | options}


@pytest.mark.slow
def test_a_design_from_post_to_results_and_its_report(client, ended):
    url = client.post("/jobs", json=REQUEST).headers["location"]
    job = ended(client, url, 120.0)
    assert (job["status"], job["kind"], job["progress"]) == ("successful", "design", 100)
    found = client.get(f"{url}/results").json()["design"]
    assert len(found["experiment"]["u"]["drive"]) == 60
    assert max(map(abs, found["experiment"]["u"]["drive"])) <= 1.0
    assert [one["effect"] for one in found["causes"]] == list(REQUEST["options"]["causes"])
    assert job["message"]
    report = client.get(f"{url}/report").json()
    assert [one["id"] for one in report["sections"]] == ["causes", "input", "predictions", "length"]
    page = client.get(f"{url}/report", headers={"Accept": "text/html"}).text
    assert "Probability of the right name" in page


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"bounds": {"inputs": {"drive": [1.0, -1.0]}, "dt": 0.1}}, "options.bounds.inputs.drive.low"),
        ({"bounds": {"inputs": {"drive": [-1.0, 1.0]}}}, "options.bounds.dt"),
        ({"bounds": {"inputs": {}, "dt": 0.1}}, "options.bounds.inputs.drive"),
        ({"causes": {"drag:velocity": 0.3}}, "options.causes"),
        ({"causes": {"drag:velocity": 0.3, "magic:velocity": 1.0}}, "options.effects"),
        ({"causes": {"drag:velocity": 0.3, "coulomb:velocity": {"mass": 1.0}}},
         "options.causes.coulomb:velocity.mass"),
        ({"length": 3}, "options.length"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_by_its_field(client, options, field):
    answer = client.post("/jobs", json=_with(**options))
    assert answer.status_code == 422, answer.text
    assert field in [one["field"] for one in answer.json()["errors"]]


@pytest.mark.slow
def test_the_page_of_a_diagnosis_has_the_form(client, ended):
    url = client.post("/jobs", json=REQUEST).headers["location"]
    ended(client, url, 120.0)
    html = client.get(url, headers={"Accept": "text/html"}).text
    assert 'id="next"' in html
    assert 'id="design-form"' in html
    assert client.get("/static/job/design.js").status_code == 200


@pytest.fixture(scope="module")
def diagnosed():
    """A diagnosis and its document as it is stored."""
    model, rng = (
        engine.get_model("oscillator", effects=["coulomb:velocity"]),
        np.random.default_rng(0),
    )
    u = np.repeat(rng.uniform(-1, 1, 20), 10)
    series = engine.simulate(model, {"coulomb_velocity": 1.0}, 200, rng, u=u, dt=0.05).series
    kinds = ["coulomb:velocity", "drag:velocity"]
    found = engine.diagnose(engine.get_model("oscillator"), series, effects=kinds, alpha=0.2)
    return found, json.loads(strict_json.dumps(diagnoses.document(found, "oscillator", [])))


@pytest.mark.slow
def test_a_stored_diagnosis_asks_for_the_same_as_the_diagnosis_itself(client, ended, diagnosed):
    found, stored = diagnosed
    document = stored["diagnosis"]
    bounds = {"inputs": {"drive": {"low": -1.0, "high": 1.0}}}
    own = engine.design_experiment(found, bounds, 60, inputs=16, seed=1)
    asked = designs.next_of(document)
    assert asked["alarm"] == found.search.rounds[0].screen.threshold != ALARM
    assert asked["measured"] == ["y"]
    request = {  # as the page of a diagnosis sends it
        "kind": "design",
        "model": asked["model"],
        "parameters": {"start": asked["theta"], "free": asked["free"]},
        "options": {
            "causes": asked["causes"],
            "bounds": {**bounds, **designs.between_samples(document)},
            "length": 60,
            "inputs": 16,
            "seed": 1,
            "alarm": asked["alarm"],
            "measured": asked["measured"],
        },
    }
    url = client.post("/jobs", json=request).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    there = client.get(f"{url}/results").json()["design"]
    assert there["experiment"] == json.loads(strict_json.dumps(own.to_dict()))["experiment"]
    assert there["growth"] == json.loads(strict_json.dumps(own.to_dict()))["growth"]


def test_what_bounds_leave_out_is_as_in_the_data_of_the_effects(monkeypatch):
    seen = []
    monkeypatch.setattr(
        designs, "asked_of", lambda _, bounds, *__, **___: seen.append(bounds) or 1 / 0
    )
    setting = {"span": [0.0, 9.0], "dt": 0.02, "substeps": 2, "time_unit": "min"}
    limits = {"inputs": {"drive": [-1.0, 1.0]}, "time_unit": None}
    for more in ({}, {"dt": 0.5, "time_unit": "h"}):
        asked = _with(bounds={**limits, **more}) | {
            "model": {"name": "oscillator", "setting": setting}
        }
        prepared = validation.load(asked)
        with pytest.raises(ZeroDivisionError):
            designs.design(prepared, prepared.request, None)
    first, second = seen
    assert {name: first[name] for name in ("dt", "substeps", "time_unit")} == {
        "dt": 0.02, "substeps": 2, "time_unit": "min",
    }  # fmt: skip
    assert (second["dt"], second["substeps"], second["time_unit"]) == (0.5, 2, "h")


@pytest.mark.slow
def test_an_older_document_is_refused(diagnosed):
    document = {name: value for name, value in diagnosed[1]["diagnosis"].items() if name != "next"}
    with pytest.raises(engine.OptionError, match="earlier version; run it again"):
        designs.next_of(document)
    with pytest.raises(engine.OptionError, match="weighed fewer than two causes"):
        designs.next_of({"next": None, "verdict": "nothing"})


@pytest.mark.parametrize(
    ("options", "field"),
    [({"alarm": 0.0}, "options.alarm"), ({"measured": ["height"]}, "options.measured")],
)
def test_what_a_diagnosis_cannot_have_told_is_refused(client, options, field):
    answer = client.post("/jobs", json=_with(**options))
    assert answer.status_code == 422, answer.text
    assert field in [one["field"] for one in answer.json()["errors"]]
