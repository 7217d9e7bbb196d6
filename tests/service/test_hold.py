"""What inputs do between samples, by JSON, by file and in what is computed from it."""

import json

import numpy as np
import pytest

import engine

PUMP = (3.0 + np.sin(0.4 * np.arange(40))).tolist()
HOLDS = ("zoh", "foh", "past")


def request(**series):
    one = {"u": PUMP, "dt": 4.0} | series
    options = {"mode": "free-run"}
    return {"kind": "simulate", "model": "tanks", "series": [one], "options": options}


def simulated(client, ended, posted):
    assert posted.status_code == 201, posted.text
    url = posted.headers["Location"]
    assert ended(client, url)["status"] == "successful"
    results = client.get(f"{url}/results").json()
    return np.array(results["simulation"]["series"][0]["y"]["level"])


def expected(hold):
    series = engine.Series(np.zeros(len(PUMP)), PUMP, dt=4.0, hold=hold)
    return engine.free_run(engine.get_model("tanks"), None, series).y[:, 0]


@pytest.mark.long
def test_what_is_computed_heeds_it(client, ended):
    for hold in HOLDS:
        y = simulated(client, ended, client.post("/jobs", json=request(hold=hold)))
        np.testing.assert_allclose(y, expected(hold), rtol=1e-12)
    assert not np.allclose(expected("foh"), expected("zoh"))


def test_a_file_says_it_and_a_request_says_it_better(client, ended):
    rows = "".join(f"{4.0 * k},{u!r},5.0\n" for k, u in enumerate(PUMP))
    data = f"# hold: foh\nt,pump,level\n{rows}".encode()
    body = {"kind": "smooth", "model": "tanks", "options": {"particles": 5}}
    for said, hold in (({}, "foh"), ({"hold": "past"}, "past")):
        entry = [{"file": "a.csv", **said}]
        posted = client.post(
            "/jobs/upload",
            data={"request": json.dumps(body | {"series": entry})},
            files={"file": ("a.csv", data)},
        )
        assert posted.status_code == 201, posted.text
        url = posted.headers["Location"]
        kept = client.get(f"{url}/request").json()
        assert kept["series"][0]["hold"] == hold
        assert ended(client, url)["status"] == "successful"


@pytest.mark.parametrize("hold", ["linear", None, 1])
def test_another_word_is_a_problem(client, hold):
    answer = client.post("/jobs", json=request(hold=hold))
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "series[0].hold"
    assert "zoh" in answer.json()["errors"][0]["message"]
