"""The job kind diagnose, and extended models in every other kind."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.data import nile
from engine.diagnose import Verdict, extend, hide
from engine.diagnose.search.search import ANEW
from service import diagnoses
from service.diagnoses import Percent, in_a_line
from service.schemas import DiagnoseRequest
from service.validation import load
from tests.engine.clear_step import clear_flows


@pytest.fixture(scope="module")
def pushed():
    """300 samples of linear-2 whose reading is off by a step."""
    y = engine.simulate(engine.get_model("linear-2"), None, 300, np.random.default_rng(3)).y
    y[150:] += 4.0
    return y.tolist()


def request(data, **options):
    return {
        "kind": "diagnose",
        "model": "linear-2",
        "series": [{"y": data, "dt": 1.0}],
        "options": {"effects": ["step", "pulse", "cubic", "latent"], "seed": 1} | options,
    }


@pytest.mark.long
def test_a_diagnosis_from_post_to_results_and_its_extension_used_at_once(client, ended, pushed):
    url = client.post("/jobs", json=request(pushed)).headers["location"]
    job = ended(client, url, 120.0)
    assert (job["status"], job["kind"], job["progress"]) == ("successful", "diagnose", 100)
    found = client.get(f"{url}/results").json()["diagnosis"]
    assert found["verdict"] in ("named", "set", "unknown")
    assert found["causes"][0]["effect"] == "step:y"
    assert found["causes"][0]["parameters"]["step_y"] == pytest.approx(4.0, abs=1.0)
    assert found["page"].startswith("Diagnosis of model 'linear-2'")
    reference = found["extension"]["model"]
    assert reference["name"] == "linear-2"
    assert "step:y" in reference["with"]
    added = set(found["extension"]["theta"]) - set(found["base_theta"])
    assert added & set(found["extension"]["free"]) == {"step_y"}  # its time is held

    smooth = {
        "kind": "smooth", "model": reference, "series": [{"y": pushed, "dt": 1.0}],
        "parameters": {"values": found["extension"]["theta"]}, "options": {"particles": 50},
    }  # fmt: skip
    url = client.post("/jobs", json=smooth).headers["location"]
    job = ended(client, url, 120.0)
    assert job["status"] == "successful", job["message"]
    assert job["model"].startswith("linear-2+step:y")
    extended = client.get(f"{url}/results").json()
    plain = smooth | {"model": "linear-2", "parameters": {"values": found["base_theta"]}}
    url = client.post("/jobs", json=plain).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    base = client.get(f"{url}/results").json()
    gained = extended["log_likelihood"]["value"] - base["log_likelihood"]["value"]
    assert gained > 5.0


@pytest.mark.slow
def test_the_service_says_what_the_engine_says(client, ended, nile_diagnosis):
    flows = nile()
    effects = ["step", "pulse"]
    job = {
        "kind": "diagnose", "model": "local-level", "options": {"effects": effects, "seed": 1},
        "series": [{"y": flows.y.tolist(), "t": flows.t.tolist()}],
    }  # fmt: skip
    url = client.post("/jobs", json=job).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    results = client.get(f"{url}/results").json()
    assert "early" not in results
    there, here = results["diagnosis"], nile_diagnosis.to_dict()
    # with another number of BLAS threads sums differ in their last digits
    assert there["verdict"] == here["verdict"]
    assert there["p_value"] == pytest.approx(here["p_value"])
    assert there["base_theta"] == pytest.approx(here["base_theta"], rel=1e-6)
    assert [c["effect"] for c in there["causes"]] == [c["effect"] for c in here["causes"]]
    for one, other in zip(there["causes"], here["causes"], strict=True):
        assert one["size"] == pytest.approx(other["size"], rel=1e-4)
        assert one["gain"] == pytest.approx(other["gain"], rel=1e-4)
    assert there["gain"]["log_density"] == pytest.approx(here["gain"]["log_density"], rel=1e-3)
    assert [d["effect"] for d in there["detectable"]] == [d["effect"] for d in here["detectable"]]


@pytest.mark.slow
def test_a_model_with_effects_is_estimated(client, ended, data):
    job = {
        "kind": "estimate", "model": {"name": "linear-2", "with": ["force:z"]},
        "series": [{"y": data, "dt": 1.0}],
        "options": {"particles": 20, "iterations": 3, "standard_errors": False},
    }  # fmt: skip
    url = client.post("/jobs", json=job).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    assert set(client.get(f"{url}/trace").json()["theta"]) == {"theta", "force_z"}
    model = extend(engine.get_model("linear-2"), ["force:z"])
    assert set(client.get(f"{url}/results").json()["estimate"]) == set(model.parameter_names)


@pytest.mark.parametrize(
    ("change", "field", "word"),
    [
        ({"options": {"alpha": 1.5}}, "options.alpha", "less than 1"),
        ({"options": {"max_effects": 0}}, "options.max_effects", "greater than or equal to 1"),
        ({"options": {"held_out": 0.6}}, "options.held_out", "less than or equal to 0.5"),
        (
            {"options": {"held_out": 0.0}, "test": {"y": [1.0, 2.0]}},
            "options.held_out",
            "one of them",
        ),
        ({"options": {"effects": ["step", "magic"]}}, "options.effects[1]", "kinds are"),
        ({"parameters": {"start": {"thetta": 1.0}}}, "parameters.start.thetta", "theta"),
        ({"parameters": {"free": ["q"]}}, "parameters.free", "q"),
        ({"model": {"name": "linear-2", "with": ["force:q"]}}, "model.with", "channels are a, z"),
        ({"model": {"name": "linear-2", "with": ["force"]}}, "model.with", "channels are"),
        ({"test": {"y": [[1.0, 2.0], [1.0, 2.0]]}}, "test.y", "needs 1"),
        ({"series": []}, "series", "at least 1"),
    ],
)
def test_what_is_wrong_is_named(client, pushed, change, field, word):
    answer = client.post("/jobs", json=request(pushed) | change)
    assert answer.status_code == 422, answer.text
    error = answer.json()["errors"][0]
    assert error["field"].startswith(field)
    assert word in error["message"]


def test_too_few_measurements_are_refused_with_the_reason(client):
    answer = client.post("/jobs", json=request([[0.1 * i] for i in range(20)]))
    assert answer.status_code == 422
    assert (
        "needs at least 30, of all records together, as it fits"
        in answer.json()["errors"][0]["message"]
    )


@pytest.mark.slow
def test_what_was_kept_of_a_model_that_has_changed_since_is_not_used():
    flows = clear_flows()
    document = {
        "kind": "diagnose",
        "model": "local-level",
        "series": [{"y": flows.y.tolist(), "t": flows.t.tolist()}],
        "options": {"effects": ["step"], "seed": 1},
    }
    told = []
    silent = SimpleNamespace(step=lambda k, message="", share=None: None, estimated=told.append)
    job = load(document)
    kept = {}
    expected = diagnoses.diagnose(job, job.request, silent, kept)["diagnosis"]
    stale = {"asked": kept["asked"] | {"another model": "0"}, "fit local-level": "not read"}
    found = diagnoses.diagnose(job, job.request, silent, stale)["diagnosis"]
    assert found["causes"] == expected["causes"]
    assert stale.keys() == kept.keys()
    assert [one["early"]["screen"] is None for one in told] == [True, False] * 2


@pytest.mark.slow
def test_what_is_known_while_it_goes_on_and_after_it_was_stopped(client, ended, eventually):
    """The fit and its simulation with the status, as a result and as a report; Stop keeps them."""
    servo = engine.get_model("servo")
    u = np.repeat(np.random.default_rng(1).uniform(-8, 8, 24), 25)
    series = hide(
        servo, ["drag:velocity"], {"drag_velocity": 0.6}, 600, np.random.default_rng(2), u=u, dt=0.02
    ).series  # fmt: skip
    url = client.post(
        "/jobs",
        json={
            "kind": "diagnose", "model": "servo",
            "series": [{"y": series.y.tolist(), "u": series.u.tolist(), "dt": 0.02}],
            "parameters": {"free": ["M", "Fv", "Fc", "offset", "sigma_v", "sigma_load", "sigma_y"]},
            "options": {"seed": 1},
        },
    ).headers["location"]  # fmt: skip

    def known(name):
        job = client.get(url).json()
        assert job["status"] in ("accepted", "running"), job["message"]
        return any(one["name"].startswith(name) for one in job["values"])

    eventually(lambda: known("error of the simulation of y"), 300.0)
    job = client.get(url).json()
    assert {"results", "report"} <= {link["rel"] for link in job["links"]}
    early = client.get(f"{url}/results").json()["early"]
    (fit,) = early["symptoms"]["free_run"]["fits"]
    values = {one["name"]: one for one in job["values"]}
    assert values["error of the simulation of y"]["value"] == fit["rmse"]
    assert values["Fv"]["standard_error"] == early["estimate"]["Fv"]["standard_error"] > 0.0
    assert early["estimate"]["gtau"]["fixed"]
    eventually(lambda: known("first screen: "), 300.0)
    stopped = client.post(f"{url}/stop").json()
    assert stopped["status"] == "dismissed"
    assert stopped["values"]
    early = client.get(f"{url}/results").json()["early"]
    assert early["screen"]["scores"]
    report = client.get(f"{url}/report", headers={"Accept": "text/html"}).text
    assert "so far" in report
    assert "Free-run simulation of y and the data" in report
    assert early["screen"]["scores"][0]["effect"] in report
    client.delete(url)  # its data
    assert client.get(f"{url}/results").status_code == 404


def test_progress_only_goes_forward():
    told = []
    percent = Percent(lambda k, message, share: told.append((k, message, share)))
    for share in (0.0, 0.15, 0.4, 0.7, 1.0, 0.5):
        percent("fit", share)
    assert [k for k, _, _ in told] == [0, 1, 2, 4, 7]  # it moves while the model is fitted
    percent("search", 0.0)
    for _ in range(3):
        for stage in ("screen", "refit"):
            for k in range(10):
                percent(stage, k / 10)
    percent("looking back", 0.5)
    percent("free run", 0.5)
    percent("bootstrap", 0.5)
    percent("gain", 0.0)
    percent("symptoms", 0.0)
    percent("symptoms", 1.0)
    steps = [k for k, _, _ in told]
    assert steps == sorted(steps)
    assert steps[-3:] == [91, 95, 100]


def test_a_search_that_begins_otherwise_is_told_as_one():
    told = []
    percent = Percent(lambda k, message, share: told.append((k, message, share)))
    percent("looking back", 1.0)
    for share in (0.0, 0.25, 0.5):
        percent(ANEW, share)
    steps = [k for k, _, _ in told]
    assert steps == [50, 50, 56, 62]
    assert {said[1:] for said in told[1:]} == {
        ("searching once more, with another effect as the first", None)
    }


def test_stages_of_counted_steps_tell_their_own_share():
    """A per cent of the whole may be long; by that share the time is known that is left of the stage."""
    told = []
    percent = Percent(lambda k, message, share: told.append((k, message, share)))
    for _ in range(4):
        percent("screen", 1.0)
        for k in range(19):
            percent("calibration", (k + 1) / 19)
        for k in range(12):
            percent("refit", k / 12)
    for k in range(30):
        percent("looking back", k / 30)
    assert len(set(told)) > 4 * 19 + 4 * 12 + 30 - 4
    assert [k for k, _, _ in told] == sorted(k for k, _, _ in told)
    assert told[10][1:] == (
        "calibrating p-values on simulated series, 53 % of them",
        pytest.approx(10 / 19),
    )
    percent("gain", 0.0)
    assert told[-1][2] is None


@pytest.mark.long
def test_several_records_and_several_held_out_ones(client, ended, pushed):
    parts = [{"y": pushed[:160], "dt": 1.0}, {"y": pushed[160:220], "dt": 1.0}]
    job = request(pushed) | {"series": parts, "test": [{"y": pushed[220:260]}, {"y": pushed[260:]}]}
    job["options"] = {"effects": ["step"], "seed": 1}
    url = client.post("/jobs", json=job).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    found = client.get(f"{url}/results").json()["diagnosis"]
    assert "160 samples of y, and 1 more record" in found["page"]
    wrong = client.post(
        "/jobs", json=job | {"test": [{"y": pushed[:50]}, {"y": [[1.0, 2.0]] * 40}]}
    )
    assert wrong.status_code == 422
    assert wrong.json()["errors"][0]["field"] == "test[1].y"


@pytest.mark.long
def test_the_list_of_jobs_says_what_was_found(clear_diagnosis):
    """The cause with its size, not that there is one."""
    said = in_a_line(clear_diagnosis)
    (cause,) = clear_diagnosis.causes
    assert said.startswith(f"Step of the reading flow {cause.size:.0f} +- ")
    assert said.endswith("dopted on held-out data.")
    several = replace(cause, equivalent=(cause.effect, "pulse:flow", "drift:flow"))
    assert ", or pulse:flow or drift:flow" in in_a_line(replace(clear_diagnosis, causes=(several,)))
    assert in_a_line(replace(clear_diagnosis, gain=None)).endswith(
        "No data were held out to judge it."
    )
    unknown = replace(clear_diagnosis, verdict=Verdict.UNKNOWN)
    assert in_a_line(unknown).startswith(Verdict.UNKNOWN.sentence + " Nearest: Step of")
    nothing = replace(clear_diagnosis, verdict=Verdict.NOTHING, causes=())
    assert in_a_line(nothing) == Verdict.NOTHING.sentence


def test_held_out_data_are_kept_as_they_were_sent():
    one = {"y": [[1.0], [2.0]], "dt": 1.0}
    for sent in (None, one, [one, one]):
        asked = DiagnoseRequest(kind="diagnose", model="linear-2", series=[one], test=sent)
        kept = asked.model_dump()["test"]
        again = DiagnoseRequest(kind="diagnose", model="linear-2", series=[one], test=kept)
        assert len(again.test) == (
            0 if sent is None else len(sent) if isinstance(sent, list) else 1
        )
        assert isinstance(kept, list) == isinstance(sent, list)
        assert (kept is None) == (sent is None)


def test_the_share_that_is_held_out_is_asked_for(monkeypatch):
    asked = {}
    monkeypatch.setattr(engine, "diagnose", lambda *given, **options: asked.update(options))
    monkeypatch.setattr(diagnoses, "document", lambda *found: {})
    for share in (None, 0.0):
        sent = request(
            [[float(k % 7)] for k in range(40)], **({} if share is None else {"held_out": share})
        )
        job = load(sent)
        diagnoses.diagnose(job, job.request, SimpleNamespace(step=None))
        assert asked["held_out"] == (0.2 if share is None else share)
