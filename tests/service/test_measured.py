"""Measured data through POST /jobs: the cascaded tanks, estimated and simulated on the test record."""

import numpy as np
import pytest

import engine

FIRST = 50  # samples of the test record that may be used for the initial state


def free_run_rmse(model, theta, test):
    """RMSE of the test record after its first samples, from the initial state that fits those best."""
    fit = engine.fit_simulation(model, test.part(0, FIRST), theta0=theta, free=[])
    run = engine.free_run(model, theta, test, a1=fit.a1[0], z1=fit.z1[0])
    return float(np.sqrt(np.mean((run.y[FIRST:] - test.y[FIRST:]) ** 2)))


@pytest.mark.slow
def test_tanks(client, ended, measured_data):
    folder = measured_data("cascaded_tanks")
    record = engine.Series.read(folder / "estimation.csv", dt=4.0)
    test = engine.Series.read(folder / "test.csv", dt=4.0)
    response = client.post(
        "/jobs",
        json={
            "kind": "estimate",
            "model": "tanks",
            "series": [{"y": record.y.tolist(), "u": record.u.tolist(), "dt": 4.0}],
            "options": {"particles": 20, "iterations": 8, "seed": 1, "standard_errors": False},
        },
    )
    assert response.status_code == 201, response.text
    job = ended(client, response.headers["location"], 240.0)
    assert job["status"] == "successful", job
    results = client.get(f"{response.headers['location']}/results").json()

    model = engine.get_model("tanks")
    theta = model.theta({name: p["value"] for name, p in results["estimate"].items()})
    fitted = engine.fit_simulation(model, record)
    assert free_run_rmse(model, fitted.theta, test) < 0.72
    assert (
        free_run_rmse(model, theta, test) < 1.2
    )  # likelihood is not simulation error: see tanks.md
