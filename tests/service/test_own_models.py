"""Models of the user's own in the service: from files, with what the check says, never another version."""

import os

import pytest

from engine.models import registry
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


# Whoever imports the file or calls its functions leaves the number of their process.
WATCHED = """
import os
from pathlib import Path
def called():
    with open(Path(__file__).with_name("calls"), "a") as log:
        log.write(f"{os.getpid()}\\n")
called()
""" + MINE.replace("    return", "    called()\n    return")


@pytest.fixture
def with_models(make_client):
    """A service in this process with files of models."""
    yield lambda models, **settings: make_client(models=str(models), workers=1, **settings)
    registry._own.references.clear()
    registry._read_files()


def test_the_service_itself_calls_no_function_of_theirs(with_models, tmp_path, request_):
    (tmp_path / "mine.py").write_text(WATCHED)
    client = with_models(tmp_path / "mine.py")
    shown = client.get("/models/mine").json()
    assert shown["check"][0].startswith("Shapes, values and covariances are right")
    assert any(row != [0.0] for row in shown["example"]["series"][0]["y"])
    assert shown in client.get("/models").json()["models"]
    extended = {"name": "mine", "with": ["drag:x"]}
    more = client.post("/models/extend", json=extended).json()
    assert [one["name"] for one in more["parameters"]] == ["c", "drag_x", "drag_x_zero"]
    assert more["check"][0].startswith("Shapes")
    refused = client.post("/models/extend", json={"name": "mine", "with": ["drag:y"]})
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, "model.with")
    assert client.post("/jobs", json=request_ | {"model": extended}).status_code == 201
    design = {
        "kind": "design", "model": "mine", "parameters": {"start": {"c": 0.5}},
        "options": {"bounds": {"inputs": {"push": [-1.0, 1.0]}, "dt": 1.0}, "length": 30,
                    "causes": {"drag:x": 0.3, "offset:reading": 0.1}},
    }  # fmt: skip
    answer = client.post("/jobs", json=design)
    assert answer.status_code == 201, answer.text
    wrong = design | {
        "options": design["options"] | {"causes": {"drag:x": {"mass": 1.0}, "a": 1.0}}
    }
    field = client.post("/jobs", json=wrong).json()["errors"][0]["field"]
    assert field == "options.causes.drag:x.mass"
    calls = (tmp_path / "calls").read_text().split()
    assert calls
    assert str(os.getpid()) not in calls


def test_a_function_that_ends_its_process_is_told(with_models, tmp_path):
    """Where it is first called so late: the model can be used up to there."""
    text = MINE.replace(
        "measurement(a, u, t, theta):\n", "measurement(a, u, t, theta):\n    late(t)\n"
    )
    late = "\nimport os\ndef late(t):\n    if np.ndim(t) == 0 and t > 5:\n        os._exit(0)\n"
    (tmp_path / "mine.py").write_text(text + late)
    client = with_models(tmp_path / "mine.py")
    for _ in range(2):
        (mine,) = [one for one in client.get("/models").json()["models"] if one["own"]]
        told = "Could not be tried to the end: the worker process ended with exit code 0."
        assert mine["check"][-1] == told
    assert client.get("/models/mine").json() == mine


def test_a_file_that_does_not_return_is_told_and_not_tried_again(with_models, tmp_path):
    (tmp_path / "mine.py").write_text("import time\nwhile True:\n    time.sleep(60.0)\n")
    client = with_models(tmp_path, model_seconds=0.1)
    told = client.get("/models").json()
    assert told["broken_plugins"] == {
        "mine.py": "mine.py: what it calls did not return within 0.1 s"
    }
    assert not any(one["own"] for one in told["models"])
    refused = client.post(
        "/jobs", json={"kind": "smooth", "model": "mine", "series": [{"y": [[1.0]]}]}
    )
    assert refused.status_code == 422
    assert "did not return" in refused.json()["detail"]
    assert str(tmp_path) not in refused.text
    (read,) = registry._own.read.values()
    assert client.get("/models").json() == told
    assert next(iter(registry._own.read.values())) is read
