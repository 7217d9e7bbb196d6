"""The Guide's measured record over HTTP: its requests as they stand, and the extension as it was found."""

import json
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "service" / "guide" / "pages" / "measured.md"


def test_from_csv_to_an_adopted_extension(client, ended):
    example = client.get("/examples/nile.csv").content
    text = PAGE.read_text(encoding="utf-8")
    asked = [json.loads(one) for one in re.findall(r"'request=(\{.*?\})'\n", text, re.DOTALL)]

    def run(request):
        files = {"file": ("nile.csv", example)}
        answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
        assert answer.status_code == 201, answer.text
        done = ended(client, answer.headers["location"], 120.0)
        assert done["status"] == "successful", done["message"]
        return client.get(f"{answer.headers['location']}/results").json()

    diagnose, estimate = asked
    found = run(diagnose)["diagnosis"]
    assert (found["verdict"], found["gain"]["adopt"]) == ("named", True)
    extension = found["extension"]
    assert estimate["model"]["with"] == extension["model"]["with"]
    assert estimate["parameters"]["free"] == extension["free"]
    for name, value in estimate["parameters"]["start"].items():
        assert value == pytest.approx(extension["theta"][name], abs=1.0)

    as_found = {"start": extension["theta"], "free": extension["free"]}
    for request in (estimate, estimate | {"model": extension["model"], "parameters": as_found}):
        step = run(request)["estimate"]["step_flow"]
        assert step["value"] == pytest.approx(-248.0, abs=3.0)
        assert step["standard_error"] == pytest.approx(28.0, abs=3.0)
