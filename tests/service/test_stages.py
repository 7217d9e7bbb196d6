"""Several starts and the bootstrap: tasks in stages, reduced to one result."""

import numpy as np
import pytest

import engine
from service import computations, stages
from service.schemas import EstimateRequest
from service.validation import prepare


@pytest.mark.long
def test_best_of_several_starts(client, estimation, ended):
    request = estimation(method="rts-em", iterations=10, starts=4)
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


@pytest.mark.slow
def test_bootstrap_agrees_with_the_observed_information(client, estimation, ended):
    request = estimation(method="rts-em", iterations=10, standard_errors=True)
    plain = client.post("/jobs", json=request).headers["location"]
    request["options"]["bootstrap"] = 12
    url = client.post("/jobs", json=request).headers["location"]
    found = []
    for one in (plain, url):
        job = ended(client, one)
        assert job["status"] == "successful", job["message"]
        found.append(client.get(f"{one}/results").json())
    errors = [one["estimate"]["theta"]["standard_error"] for one in found]
    assert found[0]["estimate"]["theta"]["value"] == found[1]["estimate"]["theta"]["value"]
    # 12 draws: the ratio's own standard error is 20 %, and the likelihood is not quite quadratic
    assert errors[1] == pytest.approx(errors[0], rel=0.5)
    assert (found[1]["bootstrap"]["runs"], found[1]["bootstrap"]["failed"]) == (12, 0)
    low, _, high = found[1]["bootstrap"]["quantiles"]["theta"].values()
    assert low < found[1]["estimate"]["theta"]["value"] < high


class Left:
    """Stands in for the store: what tasks left, and nothing done before."""

    def __init__(self):
        self.tasks = {}

    def rows(self):
        return np.empty((0, 0))

    def left(self, task):
        return self.tasks[task]

    def start(self, *args):
        pass

    iteration = step = estimated = start


def test_further_starts_and_a_bootstraps_runs_climb_from_where_they_are(estimation, monkeypatch):
    """What is searched around the first start is not searched again around each of the others."""
    asked = []

    def spied(*args, warm_start=True, **options):
        asked.append(warm_start)
        return engine.rbps_em(*args, warm_start=False, **{**options, "n_iterations": 1})

    monkeypatch.setitem(computations.METHODS, "quasi-newton", spied)
    given = estimation(method="quasi-newton", starts=2, bootstrap=2, particles=5)
    job = prepare(EstimateRequest.model_validate(given))
    progress = Left()
    for task in range(5):
        progress.tasks[task] = stages.run(job, task, progress)
    assert asked == [True, "uphill", "uphill", "uphill"]


def summary_of(estimation, runs):
    """The document of a bootstrap that left these runs, factors of theta or None where it failed."""
    given = estimation(method="quasi-newton", bootstrap=len(runs), particles=5)
    job = prepare(EstimateRequest.model_validate(given))
    theta = np.array(job.theta)
    estimate = {
        name: {"value": value, "standard_error": None}
        for name, value in zip(job.model.parameter_names, theta.tolist(), strict=True)
    }
    left = [{"theta": (theta * (k or 1.0)).tolist(), "success": k is not None} for k in runs]
    progress = Left()
    progress.tasks.update(enumerate([{"estimate": estimate, "message": "Converged."}, *left]))
    return theta, stages.run(job, 1 + len(runs), progress)


def test_runs_of_a_bootstrap_that_fail_are_told(estimation):
    """Half of them may fail just for the data that the estimate's interval should tell of."""
    _, found = summary_of(estimation, [1.0, 1.1, None, None])
    assert "2 of 4 bootstrap runs failed and are left out" in found["message"]
    assert found["bootstrap"]["failed"] == 2


@pytest.mark.parametrize("n", [20, 39])
def test_few_runs_of_a_bootstrap_make_no_interval_of_95_per_cent(estimation, n):
    """Ends between the outermost of 20 hold 86 %, and were called 95 %."""
    factors = np.linspace(1.0, 2.0, n)
    theta, found = summary_of(estimation, factors.tolist())
    name = next(iter(found["bootstrap"]["estimates"]))
    ends = found["estimate"][name]["interval"]
    np.testing.assert_allclose(ends, [theta[0], 2.0 * theta[0]])
    assert ("holds 90 % at most" in found["message"]) == (n == 20)
