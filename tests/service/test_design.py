"""The job kind design: accepted, computed, refused by the field."""

import pytest

from service.examples import EXAMPLES

REQUEST = EXAMPLES["design"]["value"]


def _with(**options):
    return REQUEST | {"options": REQUEST["options"] | options}


def test_a_design_from_post_to_results_and_its_report(client, ended):
    url = client.post("/jobs", json=REQUEST).headers["location"]
    job = ended(client, url, 120.0)
    assert (job["status"], job["kind"], job["progress"]) == ("successful", "design", 100)
    found = client.get(f"{url}/results").json()["design"]
    assert len(found["experiment"]["u"]["drive"]) == 60
    assert max(map(abs, found["experiment"]["u"]["drive"])) <= 1.0
    assert [one["effect"] for one in found["causes"]] == list(REQUEST["options"]["causes"])
    assert job["message"]
    report = client.get(f"{url}/report").json()
    assert [one["id"] for one in report["sections"]] == ["causes", "input", "predictions", "length"]
    page = client.get(f"{url}/report", headers={"Accept": "text/html"}).text
    assert "Probability of the right name" in page


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"bounds": {"inputs": {"drive": [1.0, -1.0]}, "dt": 0.1}}, "options.bounds.inputs.drive.low"),
        ({"bounds": {"inputs": {"drive": [-1.0, 1.0]}}}, "options.bounds.dt"),
        ({"bounds": {"inputs": {}, "dt": 0.1}}, "options.bounds.inputs.drive"),
        ({"causes": {"drag:velocity": 0.3}}, "options.causes"),
        ({"causes": {"drag:velocity": 0.3, "magic:velocity": 1.0}}, "options.effects"),
        ({"causes": {"drag:velocity": 0.3, "coulomb:velocity": {"mass": 1.0}}},
         "options.causes.coulomb:velocity.mass"),
        ({"length": 3}, "options.length"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_by_its_field(client, options, field):
    answer = client.post("/jobs", json=_with(**options))
    assert answer.status_code == 422, answer.text
    assert field in [one["field"] for one in answer.json()["errors"]]


def test_the_page_of_a_diagnosis_has_the_form(client, ended):
    url = client.post("/jobs", json=REQUEST).headers["location"]
    ended(client, url, 120.0)
    html = client.get(url, headers={"Accept": "text/html"}).text
    assert 'id="next"' in html
    assert 'id="design-form"' in html
    assert client.get("/static/job/design.js").status_code == 200
