"""An estimation that used its iterations up goes on with more of them, as one long run."""

import pytest


def _without_times(results):
    del results["trace"]["seconds"], results["created"]
    return results


@pytest.mark.long
@pytest.mark.parametrize("method", ["rbps-em", "quasi-newton"])
def test_more_iterations_give_the_digits_of_one_long_run(client, estimation, ended, method):
    short = estimation(method=method, iterations=2, particles=10)
    short["series"][0]["y"] = short["series"][0]["y"][:40]
    url = client.post("/jobs", json=short).headers["location"]
    job = ended(client, url)
    assert job["outcome"] == "iterations-used-up"
    assert "resume" in [link["rel"] for link in job["links"]]
    answer = client.post(f"{url}/resume")
    assert (answer.status_code, "give more of them" in answer.json()["detail"]) == (409, True)
    answer = client.post(f"{url}/resume", json={"iterations": 2})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "iterations")
    answer = client.post(f"{url}/resume", json={"iterations": 10**9})
    assert "this service allows" in answer.json()["errors"][0]["message"]
    resumed = client.post(f"{url}/resume", json={"iterations": 4})
    assert (resumed.status_code, resumed.json()["iterations"]) == (200, 4)
    assert ended(client, url)["status"] == "successful"
    assert client.get(f"{url}/request").json()["options"]["iterations"] == 4
    long = {**short, "options": {**short["options"], "iterations": 4}}
    other = client.post("/jobs", json=long).headers["location"]
    ended(client, other)
    found, expected = (_without_times(client.get(f"{one}/results").json()) for one in (url, other))
    assert found["trace"]["iteration"][-1] == 4
    assert found == expected


@pytest.mark.long
def test_a_result_is_there_while_it_goes_on(client, estimation, ended):
    url = client.post("/jobs", json=estimation(iterations=1)).headers["location"]
    ended(client, url)
    before = client.get(f"{url}/results").json()["estimate"]
    client.post(f"{url}/resume", json={"iterations": 10_000})
    client.post(f"{url}/stop")
    assert client.get(f"{url}").json()["status"] == "dismissed"
    assert client.get(f"{url}/results").json()["estimate"] == before
    assert client.post(f"{url}/resume", json={"iterations": 1}).status_code == 422


def test_iterations_of_several_starts_stay_as_they_are(client, estimation, ended):
    url = client.post("/jobs", json=estimation(iterations=1, starts=2)).headers["location"]
    job = ended(client, url)
    assert "resume" not in [link["rel"] for link in job["links"]]
    assert client.post(f"{url}/resume", json={"iterations": 9}).status_code == 409
