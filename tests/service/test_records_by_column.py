"""One file with the records of several subjects over HTTP."""

import json

import numpy as np
import pytest

MODEL = "local-level"
LENGTHS = (4, 6, 5)


@pytest.fixture(scope="module")
def text():
    """Three subjects, the rows of the first two in each other's way, at times of their own."""
    rng = np.random.default_rng(1)
    rows = []
    for subject, n in zip("xyz", LENGTHS, strict=True):
        times = np.cumsum(rng.uniform(0.5, 2.0, n))
        rows.append([f"{subject},{t:.3f},{rng.normal(1000.0, 50.0):.2f}" for t in times])
    mixed = [rows[0][0], rows[1][0], *rows[0][1:], *rows[1][1:], *rows[2]]
    return "\n".join(["Subject,time [year],flow", *mixed]) + "\n"


def posted(client, text, **entry):
    request = {"kind": "estimate", "model": MODEL, "options": {"iterations": 1}}
    request["series"] = [{"file": "flows.csv", **entry}]
    file = ("file", ("flows.csv", text))
    return client.post("/jobs/upload", data={"request": json.dumps(request)}, files=[file])


@pytest.mark.parametrize("by", ["Subject", ["Subject"]])
def test_over_http(client, text, by):
    answer = posted(client, text, by=by)
    assert answer.status_code == 201, answer.text
    asked = client.get(f"{answer.headers['location']}/request").json()
    client.post(f"{answer.headers['location']}/stop")
    assert [len(one["t"]) for one in asked["series"]] == list(LENGTHS)
    assert {one["time_unit"] for one in asked["series"]} == {"year"}
    (note,) = asked["notes"]
    assert note.endswith("3 records, counted from 0 as Subject x; Subject y; Subject z.")


@pytest.mark.parametrize(
    ("entry", "field", "said"),
    [
        ({}, "series[0].file", 'If the column \'Subject\' names the records, say "by": "Subject"'),
        ({"by": "Patient"}, "series[0].by", "no column 'Patient'"),
        ({"by": 3}, "series[0].by", "valid list"),
    ],
)
def test_what_is_wrong_over_http(client, text, entry, field, said):
    answer = posted(client, text, **entry)
    (error,) = answer.json()["errors"]
    assert answer.status_code == 422
    assert error["field"] == field
    assert said in error["message"]


def test_a_table_given_twice_is_still_refused(client, text):
    request = {"kind": "estimate", "model": MODEL}
    request["series"] = 2 * [{"file": "flows.csv", "by": "Subject"}]
    file = ("file", ("flows.csv", text))
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=[file])
    assert answer.json()["errors"][0]["field"] == "series[1].file"


def test_a_preview_has_the_times_of_the_first_record(client, text):
    def look(**form):
        answer = client.post("/preview", data=form, files={"file": ("flows.csv", text)})
        return answer.status_code, answer.json()

    status, shown = look()
    assert status == 200
    assert "If the column 'Subject' names the records" in shown["time"]["problem"]
    status, shown = look(by="Subject")
    assert shown["time"]["problem"] is None
    assert shown["time"]["last"] - shown["time"]["first"] < 8.0
    assert look(by="Patient")[1]["errors"][0]["field"] == "by"
