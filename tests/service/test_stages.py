"""Several starts and the bootstrap: tasks in stages, reduced to one result."""

import json

import pytest

from service import stages
from service.prepare import load
from service.settings import Settings
from service.store import Store


def test_best_of_several_starts(client, estimation, ended):
    request = estimation(method="rts-em", iterations=30, starts=4)
    request["parameters"]["ranges"] = {"theta": [0.0, 0.5]}
    url = client.post("/jobs", json=request).headers["location"]
    job = ended(client, url)
    assert job["status"] == "successful", job["message"]
    found = client.get(f"{url}/results").json()
    starts = found["starts"]
    assert starts[0]["start"]["theta"] == 0.3
    assert len({start["start"]["theta"] for start in starts}) == 4
    assert all(0.0 <= start["start"]["theta"] <= 0.5 for start in starts)
    best = max(starts, key=lambda start: start["log_likelihood"]["value"])
    assert found["estimate"]["theta"]["value"] == best["estimate"]["theta"]
    assert found["trace"]["theta"]["theta"][0] == best["start"]["theta"]
    assert (
        client.get(f"{url}/trace?task=2").json()["theta"]["theta"][0] == starts[2]["start"]["theta"]
    )


def test_bootstrap_agrees_with_the_observed_information(client, estimation, ended):
    request = estimation(method="rts-em", iterations=20, standard_errors=True)
    plain = client.post("/jobs", json=request).headers["location"]
    request["options"]["bootstrap"] = 24
    url = client.post("/jobs", json=request).headers["location"]
    found = []
    for one in (plain, url):
        job = ended(client, one)
        assert job["status"] == "successful", job["message"]
        found.append(client.get(f"{one}/results").json())
    errors = [one["estimate"]["theta"]["standard_error"] for one in found]
    assert found[0]["estimate"]["theta"]["value"] == found[1]["estimate"]["theta"]["value"]
    # 24 draws: the ratio's own standard error is 15 %, and the likelihood is not quite quadratic
    assert errors[1] == pytest.approx(errors[0], rel=0.5)
    assert (found[1]["bootstrap"]["runs"], found[1]["bootstrap"]["failed"]) == (24, 0)
    low, _, high = found[1]["bootstrap"]["quantiles"]["theta"].values()
    assert low < found[1]["estimate"]["theta"]["value"] < high


def test_stages_follow_each_other_whoever_runs_them(tmp_path, estimation):
    """Two attempts at once, one lost and taken up again: each stage once, in order."""
    request = estimation(method="rts-em", iterations=3, starts=2, bootstrap=2)
    job = load(request)
    plan = stages.plan(job.request)
    assert plan == [("fit", 2), ("choose", 1), ("resample", 2), ("summarize", 1)]
    store = Store(Settings(state_dir=tmp_path).store_url)
    made = store.create("estimate", "linear-2", request, 12, [n for _, n in plan])
    first, second = store.claim("a", 10.0), store.claim("b", 10.0)
    assert (first.task, second.task) == (0, 1)
    assert store.claim("c", 10.0) is None
    assert store.lost(first, "killed", 2)
    first = store.claim("a", 10.0)
    assert (first.task, first.losses) == (0, 1)
    assert store.finish(second, {"n": 1})
    assert store.claim("c", 10.0) is None
    assert store.finish(first, {"n": 0})
    choose = store.claim("c", 10.0)
    assert choose.task == 2
    assert store.claim("d", 10.0) is None
    assert json.loads(store.document(choose.job, "task-1")) == {"n": 1}
    assert store.finish(choose, {"n": 2})
    third, fourth = store.claim("a", 10.0), store.claim("b", 10.0)
    assert (third.task, fourth.task) == (3, 4)
    assert store.finish(third, {})
    assert store.finish(fourth, {})
    assert store.job(made).status == "running"
    assert store.finish(store.claim("a", 10.0), {"n": 5})
    assert store.job(made).status == "successful"
    store.close()
