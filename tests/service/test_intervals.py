"""The 95 % intervals beside the standard errors."""

import numpy as np
import pytest

import engine


@pytest.mark.slow
def test_intervals_by_the_likelihood_ratio_or_symmetric(client, estimation, ended):
    found = {}
    for kind in ("likelihood-ratio", "symmetric"):
        request = estimation(method="rts-em", iterations=20, standard_errors=True, intervals=kind)
        url = client.post("/jobs", json=request).headers["location"]
        job = ended(client, url)
        assert job["status"] == "successful", job["message"]
        found[kind] = client.get(f"{url}/results").json()["estimate"]["theta"]
    value, error = found["symmetric"]["value"], found["symmetric"]["standard_error"]
    low, high = found["symmetric"]["interval"]
    assert (low + high) / 2 == pytest.approx(value)
    assert (high - low) / 2 == pytest.approx(1.96 * error, rel=1e-3)
    assert found["likelihood-ratio"]["standard_error"] == error
    model = engine.get_model(request["model"])
    (series,) = (engine.Series(one["y"], dt=one["dt"]) for one in request["series"])
    expected = engine.likelihood_intervals(model, [value], series, exact=True).values[0]
    np.testing.assert_allclose(found["likelihood-ratio"]["interval"], expected, rtol=1e-6)
    assert abs(expected.mean() - value) > 0.02 * error


def test_no_intervals_without_standard_errors(client, estimation, ended):
    url = client.post("/jobs", json=estimation(method="rts-em", iterations=2)).headers["location"]
    ended(client, url)
    theta = client.get(f"{url}/results").json()["estimate"]["theta"]
    assert theta["interval"] is None
    assert theta["standard_error"] is None
