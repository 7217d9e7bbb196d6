"""The list of jobs: names, tags, key values, filters and order; stores of before there were such."""

import json

import pytest

from service.db_schema import jobs
from service.responses import OUTCOMES
from service.store import EVERY, Store, Which

ESTIMATED = {
    "outcome": "converged",
    "message": "Converged.",
    "log_likelihood": {"value": -12.5, "standard_error": 0.1},
    "estimate": {
        "k": {"value": 2.0, "standard_error": 0.25, "unit": "N/m"},
        "m": {"value": 1.0, "standard_error": None, "unit": "kg", "fixed": True},
    },
    "held_out": {"outputs": [{"output": "y", "unit": "m", "rmse": 0.5}]},
}
DIAGNOSED = {
    "message": "Drag 0.6.",
    "diagnosis": {
        "verdict": "named",
        "causes": [{"effect": "drag:v", "size": 0.6, "standard_error": 0.1, "unit": "1/m"}],
        "gain": {"outputs": [{"output": "y", "unit": "m", "rmse_before": 2.0, "rmse_after": 1.0}]},
    },
}


def finished(store, kind="estimate", result=ESTIMATED, **request):
    made = store.create(kind, request.pop("model", "m"), request, 1, owner=request.pop("owner", ""))
    assert store.finish(store.claim("w"), result, result.get("message", ""))
    return made


def names(store, which=EVERY, sort="-created", limit=100):
    """Of all pages, one after the other."""
    out, before = [], None
    while found := store.jobs(limit, before, which, sort):
        out += [row.name for row in found]
        before = found[-1].seq
    return out


@pytest.fixture
def listed(store):
    finished(store, name="b", tags=["pump", "may"], data=["run_1.csv"], model="tank+lag:h")
    finished(store, "diagnose", DIAGNOSED, name="A", tags=["pump 2"], data=["run01.csv"])
    finished(store, name="c", tags=["may"], data=[], model="tank")
    store.create("simulate", "tank 100%", {"name": "é, 50 %"}, 1)
    return store


@pytest.mark.long
def test_filters(listed):
    def found(**which):
        return names(listed, Which(**which))

    assert found() == ["é, 50 %", "c", "A", "b"]
    assert found(tags=["pump"]) == ["b"]  # the whole tag
    assert found(tags=["may"]) == ["c", "b"]
    assert found(tags=["may", "pump"]) == ["b"]
    assert found(tags=["%"]) == []
    assert found(outcome=["named"]) == ["A"]
    assert found(outcome=["named", "converged"], kind=["estimate"]) == ["c", "b"]
    assert found(model="tank") == ["c", "b"]
    assert found(text="RUN_1") == ["b"]  # no wildcard
    assert found(text="pump") == ["A", "b"]
    assert found(text="é") == ["é, 50 %"]
    assert found(text="drag") == ["A"]
    assert found(owner="other") == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("sort", "order"),
    [
        ("created", ["b", "A", "c", "é, 50 %"]),
        ("-created", ["é, 50 %", "c", "A", "b"]),
        ("name", ["A", "b", "c", "é, 50 %"]),
        ("-name", ["é, 50 %", "c", "b", "A"]),
        ("data", ["A", "b", "é, 50 %", "c"]),  # those without come last, the newest first
        ("-data", ["b", "A", "é, 50 %", "c"]),
        ("outcome", ["c", "b", "A", "é, 50 %"]),
        ("-outcome", ["A", "c", "b", "é, 50 %"]),
    ],
)
def test_order_and_pages(listed, sort, order):
    assert names(listed, sort=sort) == order
    for limit in (1, 2, 3):
        assert names(listed, sort=sort, limit=limit) == order


def test_what_a_result_comes_down_to(store):
    """It is gone with the data."""
    finished(store)
    row = store.job(finished(store, "diagnose", DIAGNOSED))
    assert row.outcome == "named"
    found = json.loads(row.found)
    assert found["causes"] == ["drag:v"]
    assert [(one["name"], one["value"]) for one in found["values"]] == [
        ("drag:v", 0.6),
        ("held-out error of y before", 2.0),
        ("held-out error of y after", 1.0),
    ]
    (estimate,) = store.jobs(1, None, Which(kind=["estimate"]))
    values = json.loads(estimate.found)["values"]
    assert [one["name"] for one in values] == ["log-likelihood", "held-out error of y", "k"]
    assert values[2] == {"name": "k", "value": 2.0, "standard_error": 0.25, "unit": "N/m"}
    gone = store.dismiss(row.id)
    assert (gone.outcome, gone.found) == (None, None)


def test_a_store_of_before_there_were_names_still_opens(store):
    """Its jobs have no name, no tags; what they found is looked up in their results, once."""
    made = [finished(store), finished(store, "diagnose", DIAGNOSED)]
    waiting = store.create("simulate", "m", {}, 1)
    with store._engine.begin() as sql:
        for column in ("name", "tags", "data", "outcome", "found"):
            sql.exec_driver_sql(f"ALTER TABLE jobs DROP COLUMN {column}")
    newer = Store(store.url)
    rows = [newer.job(one) for one in (*made, waiting)]
    assert [row.outcome for row in rows] == ["converged", "named", None]
    assert [(row.name, row.tags, row.data) for row in rows] == [("", "", "")] * 3
    assert json.loads(rows[1].found)["causes"] == ["drag:v"]
    assert set(newer.job(made[0])._mapping) == {column.name for column in jobs.columns}
    newer.label(made[0], "mine", ["old"])
    assert names(newer, Which(tags=["old"])) == ["mine"]
    assert newer.finish(newer.claim("w"), {})
    newer.close()


# ---- over HTTP --------------------------------------------------------------------------------


@pytest.mark.long
def test_a_job_has_a_name_and_tags(client, estimation, ended):
    request = estimation(method="rts-em") | {"name": "Pump 3", "tags": ["pump", "two words"]}
    url = client.post("/jobs", json=request).headers["location"]
    job = ended(client, url)
    assert (job["name"], job["tags"], job["data"]) == ("Pump 3", ["pump", "two words"], [])
    assert job["outcome"] in ("converged", "iterations-used-up")
    assert [one["name"] for one in job["values"]] == ["log-likelihood", "theta"]
    listed = client.get("/jobs", params={"tag": ["pump", "two words"]}).json()["jobs"]
    assert [one["jobID"] for one in listed] == [job["jobID"]]
    assert client.get(f"{url}/request").json()["name"] == "Pump 3"

    renamed = client.patch(url, json={"tags": []}).json()
    assert (renamed["name"], renamed["tags"]) == ("Pump 3", [])
    assert client.patch(url, json={"name": "é\\"}).json()["name"] == "é\\"
    for search in ("é", "É"):
        found = client.get("/jobs", params={"search": search}).json()["jobs"]
        assert found[0]["name"] == "é\\"
    assert client.patch("/jobs/none", json={"name": "x"}).status_code == 404
    assert {link["rel"] for link in client.get(url).json()["links"]} >= {"results"}


@pytest.mark.parametrize(
    ("labels", "field"),
    [
        ({"tags": ["a,b"]}, "tags[0]"),
        ({"tags": [""]}, "tags[0]"),
        ({"tags": ["a\nb"]}, "tags[0]"),
        ({"tags": ["a "]}, "tags[0]"),
        ({"name": "a\nb"}, "name"),
        ({"name": 201 * "a"}, "name"),
    ],
)
def test_labels_that_cannot_be(client, estimation, labels, field):
    for answer in (
        client.post("/jobs", json=estimation() | labels),
        client.patch("/jobs/none", json=labels),
    ):
        assert answer.status_code == 422
        assert [error["field"].removeprefix("estimate.") for error in answer.json()["errors"]] == [
            field
        ]


def test_an_upload_notes_the_names_of_its_files(client, ended):
    files = [
        ("file", (f"{name}.csv", "t,y\n" + "".join(f"{i},{i % 3}\n" for i in range(20))))
        for name in ("may", "june")
    ]
    request = {"kind": "smooth", "model": "local-level", "tags": ["flows"]}
    answer = client.post("/jobs/upload", data={"request": json.dumps(request)}, files=files)
    job = ended(client, answer.headers["location"])
    assert job["data"] == ["may.csv", "june.csv"]
    found = client.get("/jobs", params={"search": "june", "sort": "data"}).json()
    assert [one["jobID"] for one in found["jobs"]] == [job["jobID"]]


def test_pages_of_a_sorted_list_follow_one_another(client, data):
    simulation = {"kind": "simulate", "model": "linear-2", "options": {"samples": 3}}
    for name in ("zeta", "alpha", "mu"):
        client.post("/jobs", json=simulation | {"name": name, "tags": ["paged"]})
    url, seen = "/jobs?tag=paged&sort=name&limit=1", []
    while url:
        page = client.get(url).json()
        seen += [one["name"] for one in page["jobs"]]
        url = next((link["href"] for link in page["links"] if link["rel"] == "next"), None)
    assert seen == ["alpha", "mu", "zeta"]


@pytest.mark.parametrize(
    ("name", "allowed"),
    [("outcome", "converged"), ("status", "failed"), ("kind", "smooth"), ("sort", "-duration")],
)
def test_a_filter_that_nothing_can_pass_is_refused_and_names_what_can(client, name, allowed):
    answer = client.get("/jobs", params={name: "foo"})
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["field"].startswith(f"query.{name}")
    assert allowed in error["message"]
    assert client.get("/jobs", params={name: allowed}).status_code == 200


def test_every_outcome_of_the_page_may_be_asked_for(client):
    assert len(set(OUTCOMES)) == len(OUTCOMES)
    assert client.get("/jobs", params={"outcome": list(OUTCOMES)}).status_code == 200
    names = {
        one["name"]: one
        for one in client.get("/openapi.json").json()["paths"]["/jobs"]["get"]["parameters"]
    }
    assert names["outcome"]["schema"]["items"]["enum"] == list(OUTCOMES)


def test_a_task_that_a_job_does_not_have_is_refused(client):
    simulation = {"kind": "simulate", "model": "linear-2", "options": {"samples": 3}}
    where = client.post("/jobs", json=simulation).headers["location"]
    answer = client.get(f"{where}/trace?task=1")
    assert answer.status_code == 422
    assert "this job has task 0 only" in answer.json()["errors"][0]["message"]
    assert client.get(f"{where}/trace?task=0").status_code == 200
