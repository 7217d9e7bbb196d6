"""Progress and the time that is left are true in every stage; a stopped job keeps what it has."""

import json
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest

import engine
from engine.filters.filter_steps import FilterSteps
from service.diagnoses import Percent
from service.serializers import job_status
from service.store import Store
from tests.engine.diagnose.test_checkpoint import two_effects

ROW = {
    "id": "1", "kind": "estimate", "model": "m", "status": "running", "created": 0.0, "started": 10.0,
    "updated": 110.0, "finished": None, "iteration": 40, "iterations": 100, "message": "", "estimate": None,
    "log_likelihood": None, "removed": 0, "stages": "[1]", "stage": "iterations", "stage_share": None,
    "stage_begun": 30.0, "stage_from": 0.0, "name": "", "tags": "", "data": "", "outcome": None, "found": None,
    "cause": None,
}  # fmt: skip


def status(**changes):
    return job_status(SimpleNamespace(**ROW | changes))


def left(one):
    if one.estimated_end is None:
        return None
    return datetime.fromisoformat(one.estimated_end).timestamp() - ROW["updated"]


def test_what_is_left_of_the_iterations_is_by_their_own_rate():
    one = status()  # 40 in 80 s, after 20 s for something else
    assert left(one) == pytest.approx(120.0)
    assert (one.progress, one.stage) == (28, "iterations")
    assert left(status(stage_from=0.2)) == pytest.approx(
        240.0
    )  # the first 20 were another attempt's


@pytest.mark.parametrize(
    ("stage", "share", "percent", "seconds"),
    [
        ("smoothing the states at the estimate", None, 70, None),
        ("standard errors", None, 75, None),
        ("intervals", 0.0, 85, None),
        ("intervals", 0.5, 90, 80.0),
        ("comparing simulation and prediction with the data", None, 95, None),
    ],
)
def test_after_the_iterations(stage, share, percent, seconds):
    """Nothing is left of the iterations, of which fewer were used than there might have been."""
    one = status(stage=stage, stage_share=share, iteration=38)
    assert (one.progress, one.stage, left(one)) == (percent, stage, seconds)


def test_a_bootstrap_a_diagnosis_and_an_end():
    many = status(stages="[1, 50, 1]", iteration=2550, iterations=5100)
    assert many.progress == 47
    assert status(kind="diagnose", iteration=100, stage="measuring the gain").progress == 99
    assert left(status(kind="diagnose", stage="measuring the gain")) is None
    assert left(status(kind="diagnose", stage="refits", stage_share=0.25)) == pytest.approx(240.0)
    assert status(stage="", stage_begun=None, stage_from=None).estimated_end is None
    ended = status(status="successful", stage="comparing simulation and prediction with the data")
    assert (ended.progress, ended.stage, ended.estimated_end) == (100, "", None)


@pytest.fixture
def passes(monkeypatch):
    """Of the filter over the record, as they are made: the work of a diagnosis."""
    made, init = [0], FilterSteps.__init__

    def counted(self, *args):
        made[0] += 1
        init(self, *args)

    monkeypatch.setattr(FilterSteps, "__init__", counted)
    return made


@pytest.mark.slow
def test_the_progress_of_a_diagnosis_is_in_step_with_its_work(passes):
    """Two effects are found, and each weighed again beside the other."""
    model, series, options = two_effects()
    options |= {"effects": ["bias", "cubic", "gain", "drag", "coulomb", "latent"]}
    told = []  # (stage, per cent, passes by then) where something new was shown
    stage = [""]
    percent = Percent(lambda k, message, share: told.append((stage[0], k, passes[0])))

    def callback(name, share):
        stage[0] = name
        percent(name, share)

    found = engine.diagnose(model, series, **options, callback=callback)
    assert len(found.causes) == 2
    assert told[-1][1] == 100
    steps = np.array([k for _, k, _ in told])
    done = np.array([n for _, _, n in told]) / passes[0]
    assert (np.diff(steps) >= 0).all()
    assert np.diff(steps).max() <= 10
    assert np.diff(done, append=1.0).max() <= 0.1, "nothing stands still for long"
    names = [name for name, _, _ in told]
    assert names.count("looking back") >= 8
    for name in set(names):
        own = [i for i, one in enumerate(names[:-1]) if one == name]
        work = sum(done[i + 1] - done[i] for i in own)
        shown = sum(steps[i + 1] - steps[i] for i in own) / 100
        if work > 0.1:
            assert 1 / 3 < shown / work < 3, (name, shown, work)


@pytest.mark.long
def test_a_job_goes_through_its_stages_and_never_back(client, estimation, eventually):
    request = estimation(particles=60, iterations=15, standard_errors=True)
    url = client.post("/jobs", json=request).headers["location"]
    seen = []

    def look():
        seen.append(client.get(url).json())
        return seen[-1]["status"] in ("successful", "failed")

    eventually(look)
    assert seen[-1]["status"] == "successful", seen[-1]
    percents = [one["progress"] for one in seen]
    assert percents == sorted(percents)
    assert percents[-1] == 100
    assert all(percent < 100 for percent in percents[:-1])
    stages = [one["stage"] for one in seen]
    assert {"iterations", "standard errors"} & set(stages)
    for one in seen:
        if one["stage"] == "standard errors":
            assert one["estimated_end"] is None


@pytest.fixture
def made(store):
    return store.create("estimate", "m", {"n": 1}, 100)


@pytest.mark.parametrize("database", ["sqlite"], indirect=True)
def test_stopped_by_whom_and_where(store: Store, made):
    assert store.stop(made).message.startswith("stopped by you before it began")
    store.resume(made)
    attempt = store.claim("here")
    store.record(attempt, 40, {})
    assert store.job(made).stage == "iterations"
    row = store.stop(made)
    assert (
        row.message
        == "stopped by you at iteration 40; what it had computed is kept, and it can go on"
    )
    store.resume(made)
    assert store.job(made).stage == ""
    attempt = store.claim("here")
    store.record(attempt, 50, {})  # its rate counts from here, and what is said of it stays
    row = store.job(made)
    assert (row.stage, row.stage_from) == ("iterations", 0.4)
    assert row.message == "resumed; continues where it was"


@pytest.mark.parametrize("database", ["sqlite"], indirect=True)
def test_stages_of_the_store(store, made):
    attempt = store.claim("here")
    store.record(attempt, 30, {}, stage="iterations")
    store.record(attempt, 40, {}, message="standard errors", stage="standard errors")
    row = store.job(made)
    assert (row.stage, row.stage_share, row.stage_from, row.message) == (
        "standard errors", None, 0.0, "standard errors",
    )  # fmt: skip
    store.record(attempt, 40, {}, message="intervals, 3 of 4: q", stage="intervals", share=0.5)
    row = store.job(made)
    assert (row.stage, row.stage_share, row.stage_from) == ("intervals", 0.5, 0.5)
    begun = row.stage_begun
    store.record(attempt, 40, {}, message="intervals, 4 of 4: r", stage="intervals", share=0.75)
    assert (store.job(made).stage_begun, store.job(made).stage_from) == (begun, 0.5)
    store.record(attempt, 41, {})  # the iterations of a bootstrap, say
    row = store.job(made)
    assert (row.stage, row.message, row.stage_from) == ("iterations", "", 0.4)
    assert json.loads(row.stages) == [1]
