"""Models of the user's own in the service: from files, with what the check says, never another version."""

import pytest

from tests.cli.test_commands import MINE


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "models"
    made.mkdir()
    (made / "mine.py").write_text(MINE)
    (made / "broken.py").write_text("import nowhere_at_all\n")
    return made


@pytest.fixture
def request_():
    rows = [[0.1 * (k % 5)] for k in range(40)]
    return {"kind": "smooth", "model": "mine", "series": [{"y": rows, "u": rows}]}


@pytest.mark.slow
def test_a_folder_of_models(spawn, folder, request_, ended):
    client = spawn(models=folder).client
    document = client.get("/models/mine").json()
    assert document["own"]
    assert document["check"][0].startswith("Shapes, values and covariances are right")
    assert document["parameters"][0]["name"] == "c"
    assert "nowhere_at_all" in client.get("/models").json()["broken_plugins"]["broken.py"]
    assert not client.get("/models/servo").json()["own"]
    answer = client.post("/jobs", json=request_)
    assert answer.status_code == 201, answer.text
    url = answer.headers["location"]
    assert ended(client, url)["status"] == "successful"
    assert client.get(f"{url}/results").json()["parameters"] == {"c": 0.5}
    asked = client.get(f"{url}/request").json()
    assert len(asked["model"]["source"]) == 64

    # the file as it is now is what is computed with, and never by a job that was made with another
    (folder / "mine.py").write_text(MINE.replace('"c", 0.5', '"c", 0.7'))
    again = client.post("/jobs", json=asked)
    assert again.status_code == 422
    assert again.json()["errors"][0]["field"] == "model.source"
    assert "without source" in again.json()["detail"]
    assert client.get("/models/mine").json()["parameters"][0]["default"] == 0.7
    url = client.post("/jobs", json=request_).headers["location"]
    assert ended(client, url)["status"] == "successful"
    assert client.get(f"{url}/results").json()["parameters"] == {"c": 0.7}


@pytest.mark.slow
def test_a_file_that_changes_while_its_job_waits(spawn, folder, request_, long, ended):
    client = spawn(models=folder / "mine.py").client
    first = client.post("/jobs", json=long).headers["location"]  # the only worker has it
    url = client.post("/jobs", json=request_).headers["location"]
    (folder / "mine.py").write_text(MINE.replace('"c", 0.5', '"c", 0.7'))
    client.post(f"{first}/stop")
    job = ended(client, url)
    assert job["status"] == "failed"
    assert "is not the one this job was made with" in job["message"]
