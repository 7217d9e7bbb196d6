"""Channels that were recorded and that the model does not use."""

import json

import numpy as np
import pytest


@pytest.fixture(scope="module")
def wet():
    """Flows that follow the rain, which local-level does not know, and both as a CSV."""
    rng = np.random.default_rng(0)
    noise, rain = rng.standard_normal((2, 80))
    level = 1100 + np.cumsum(40 * noise + 150 * np.append(0.0, rain[:-1]))
    flow = level + 30 * rng.standard_normal(80)
    text = "\n".join(["flow,rain", *(f"{a:.3f},{b:.5f}" for a, b in zip(flow, rain, strict=True))])
    return flow.round(3), rain.round(5), text


REQUEST = {
    "kind": "diagnose",
    "model": "local-level",
    "options": {"effects": ["extra-input", "bias"]},
}


@pytest.mark.long
def test_a_diagnosis_names_it_and_the_extended_model_uses_it(client, ended, wet):
    flow, rain, _ = wet
    series = {"y": [[v] for v in flow], "extra": {"rain": rain.tolist()}}
    url = client.post("/jobs", json=REQUEST | {"series": [series]}).headers["location"]
    assert ended(client, url, 120.0)["status"] == "successful"
    found = client.get(f"{url}/results").json()["diagnosis"]
    (cause,) = found["causes"]
    assert cause["effect"] == "extra-input:rain->level"
    assert cause["size"] == pytest.approx(150, abs=30)
    asked = client.get(f"{url}/request").json()
    assert asked["series"][0]["extra"] == {"rain": rain.tolist()}
    again = {
        "kind": "estimate", "model": found["extension"]["model"], "series": asked["series"],
        "parameters": {"start": found["extension"]["theta"], "free": [next(iter(cause["parameters"]))]},
        "options": {"method": "rts-em", "iterations": 5},
    }  # fmt: skip
    url = client.post("/jobs", json=again).headers["location"]
    job = ended(client, url)
    assert job["status"] == "successful", job["message"]
    simulated = {
        "kind": "simulate", "model": found["extension"]["model"],
        "series": [{"extra": {"rain": rain.tolist()}, "y": series["y"]}],
    }  # fmt: skip
    assert client.post("/jobs", json=simulated).status_code == 201
    without = again | {"series": [{"y": series["y"]}]}
    assert "has inputs (rain)" in client.post("/jobs", json=without).json()["detail"]


def test_in_a_file(client, wet):
    _, rain, text = wet

    def post(request, csv=text):
        file = ("file", ("run.csv", csv))
        return client.post("/jobs/upload", data={"request": json.dumps(request)}, files=[file])

    entry = {"file": "run.csv", "y": {"flow": "flow"}, "dt": 1.0}
    answer = post(REQUEST | {"series": [entry | {"extra": ["rain"]}]})
    assert answer.status_code == 201, answer.text
    asked = client.get(f"{answer.headers['location']}/request").json()
    assert asked["series"][0]["extra"] == {"rain": rain.tolist()}
    client.post(f"{answer.headers['location']}/stop")
    # An extended model has it as an input, to be given a column as any other.
    extended = {"name": "local-level", "with": ["extra-input:rain->level"]}
    smooth = {"kind": "smooth", "model": extended, "series": [entry | {"u": {"rain": "rain"}}]}
    answer = post(smooth)
    assert answer.status_code == 201, answer.text
    client.post(f"{answer.headers['location']}/stop")

    wrong = post(REQUEST | {"series": [entry | {"extra": ["snow"]}]})
    assert "there is no column 'snow'" in wrong.json()["errors"][0]["message"]
    gap = post(REQUEST | {"series": [entry | {"extra": ["rain"]}]}, text + "\n1100,\n")
    (error,) = gap.json()["errors"]
    assert (error["field"], error["row"], error["channel"]) == ("series[0].extra", 80, "rain")


@pytest.mark.parametrize(
    ("extra", "field", "words"),
    [
        ({"rain": [1.0, 2.0]}, "series[0].extra", "'rain' has 2 rows and y has 3"),
        ({"level": [1.0, 2.0, 3.0]}, "series[0].extra", "is the name of a channel of model"),
        ({"rain": [1.0, None, 3.0]}, "series[0].extra.rain[1]", "valid number"),
        ({"a->b": [1.0, 2.0, 3.0]}, "series[0].extra", "pattern"),
    ],
)
def test_what_cannot_be_used(client, extra, field, words):
    series = {"y": [[1.0], [2.0], [3.0]], "extra": extra}
    answer = client.post("/jobs", json=REQUEST | {"series": [series]})
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["field"].startswith(field)
    assert words in error["message"]
