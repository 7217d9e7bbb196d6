"""What clients get wrong is a problem document that names the field, the row and the channel."""

import json

import pytest

from service.settings import Settings

JSON = {"Content-Type": "application/json"}


def tanks(**series):
    base = {"y": [[5.2], [None], [5.1]], "u": [[3.2], [3.2], [3.3]], "dt": 4.0}
    return {"kind": "estimate", "model": "tanks", "series": [base | series]}


def change(**more):
    return tanks() | more


ENOUGH = {"y": [[5.0 + k] for k in range(20)], "u": [[3.2]] * 20, "dt": 4.0}
BAD = {
    "no kind": (change(kind=None), "kind", None, "kind"),
    "unknown kind": (change(kind="guess"), "kind", None, "diagnose"),
    "kind missing": ({"model": "tanks"}, "kind", None, "kind"),
    "unknown member": (change(modle="tanks"), "modle", None, "no such member"),
    "unknown model": (change(model="tank"), "model", None, "tanks"),
    "effects": (change(model={"name": "tanks", "with": ["offset:y"]}), "model.with", None, "channels"),
    "no series": (change(series=[]), "series", None, "at least 1"),
    "series missing": ({"kind": "estimate", "model": "tanks"}, "series", None, "required"),
    "wide row": (tanks(y=[[1.0], [2.0, 3.0], [1.0]]), "series[0].y", 1, "2 values"),
    "wide table": (tanks(y=[[1.0, 1.0]] * 3), "series[0].y", 0, "needs 1"),
    "text": (tanks(y=[[1.0], ["2"], [1.0]]), "series[0].y", 1, "'2'"),
    "truth value": (tanks(y=[[1.0], [1.0], [True]]), "series[0].y", 2, "True"),
    "object": (tanks(y={"a": 1}), "series[0].y", None, "list of rows"),
    "mixed rows": (tanks(y=[[1.0], 2.0, [1.0]]), "series[0].y", 1, "not a list"),
    "gap in u": (tanks(u=[[3.2], [None], [3.3]]), "series[0].u", 1, "every sample"),
    "short u": (tanks(u=[[3.2]]), "series[0].u", None, "1 rows"),
    "no u": (tanks(u=None), "series[0].u", None, "has inputs"),
    "wide u": (tanks(u=[[1.0, 2.0]] * 3), "series[0].u", 0, "needs 1"),
    "nothing measured": (tanks(y=[[None]] * 3), "series[0]", None, "missing"),
    "empty": (tanks(y=[], u=[]), "series[0].y", None, "at least 2"),
    "one sample": (tanks(y=[[1.0]], u=[[1.0]]), "series[0].y", None, "at least 2"),
    "two clocks": (tanks(t=[0.0, 4.0, 8.0]), "series[0]", None, "choose one"),
    "zero dt": (tanks(dt=0.0), "series[0].dt", None, "greater than 0"),
    "t decreases": (tanks(dt=None, t=[0.0, 4.0, 3.0]), "series[0].t", 2, "decreases"),
    "t repeats": (tanks(dt=None, t=[0.0, 4.0, 4.0]), "series[0].t", 2, "repeats"),
    "short t": (tanks(dt=None, t=[0.0, 4.0]), "series[0].t", None, "2 time stamps"),
    "unknown parameter": (change(parameters={"start": {"kx": 1.0}}), "parameters.start.kx", None, "k1"),
    "out of bounds": (change(parameters={"start": {"k1": -9.0}}), "parameters.start.k1", None, "within"),
    "unknown free": (change(parameters={"free": ["kx"]}), "parameters.free.kx", None, "k1"),
    "nothing free": (change(parameters={"free": []}), "parameters.free", None, "at least 1"),
    "text option": (change(options={"particles": "50"}), "options.particles", None, "integer"),
    "few particles": (change(options={"particles": 1}), "options.particles", None, "2"),
    "unknown method": (change(options={"method": "em"}), "options.method", None, "rbps-em"),
    "negative seed": (change(options={"seed": -1}), "options.seed", None, "0"),
    "too many particles": (change(options={"particles": 10**7}), "options.particles", None, "allows"),
    "too many iterations": (change(options={"iterations": 10**7}), "options.iterations", None, "allows"),
    "too short for a diagnosis": (
        {"kind": "diagnose", "model": "local-level",
         "series": [{"y": [[1.0]] * 2}, {"y": [[1.0], [2.0], [1.5], [3.0]]}]},
        "series[1].y", None, "only 6 rows hold a measurement; a diagnosis needs at least 30",
    ),
    "nothing but one value": (
        {"kind": "diagnose", "model": "local-level", "series": [{"y": [[1.0]] * 40}]},
        "series[0].y", None, "'flow' reads 1 throughout",
    ),
    "the data as a test": (
        change(series=[ENOUGH], test=ENOUGH), "test", None, "test is record 0, which the model is fitted to",
    ),
    "data twice": (change(series=[ENOUGH, ENOUGH]), "series", None, "records 0 and 1 are the same"),
    "a test on another clock": (
        change(series=[ENOUGH], test=ENOUGH | {"time_unit": "min"}), "test", None, "in s, of another in min",
    ),
    "no length": ({"kind": "simulate", "model": "linear-2"}, "options.samples", None, "length"),
    "two lengths": (
        {"kind": "simulate", "model": "linear-2", "series": [{"t": [0.0, 1.0]}],
         "options": {"samples": 3}},
        "options.samples", None, "2 rows",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_invalid_requests_name_the_field(client, name):
    body, field, row, words = BAD[name]
    answer = client.post("/jobs", json=body)
    problem = answer.json()
    assert answer.status_code == problem["status"] == 422, problem
    assert answer.headers["content-type"] == "application/problem+json"
    error = problem["errors"][0]
    assert error["field"] == field
    assert error.get("row") == row
    assert words in error["message"]
    assert words in problem["detail"]


def test_the_channel_is_named(client):
    rows = [[1.0, 2.0]] * 3
    y = [[1.0, 2.0], [1.0, float("inf")], [1.0, 2.0]]
    request = {"kind": "smooth", "model": "mixed-4", "series": [{"y": rows}, {"y": y}]}
    answer = client.post("/jobs", content=json.dumps(request), headers=JSON)
    error = answer.json()["errors"][0]
    assert (error["field"], error["row"], error["channel"]) == ("series[1].y", 1, "y2")


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"", 422), (b"{", 400), (b"\xff\xfe{}", 400), (b"[1]", 422), (b'"text"', 422), (b"null", 422),
        (b"[" * 100_000, 400), (b"9" * 5000, 400), (b'{"kind": NaN}', 422),
    ],
)  # fmt: skip
def test_bodies_that_are_no_request(client, body, status):
    answer = client.post("/jobs", content=body, headers=JSON)
    assert answer.status_code == answer.json()["status"] == status
    assert ("is not JSON: " in answer.json()["detail"]) == (status == 400)
    assert answer.headers["content-type"] == "application/problem+json"


@pytest.mark.parametrize(
    "body", [b'{"model": "linear-2"}', b'{"kind": "fit"}', b"", b"[1]", b"null"]
)
def test_what_is_needed_is_said_where_a_request_is_none(client, body):
    (error,) = client.post("/jobs", content=body, headers=JSON).json()["errors"]
    kind = body.startswith(b"{")
    assert error["field"] == ("kind" if kind else "")
    said = (
        "the kind of job is needed, one of estimate, smooth" if kind else "a JSON object is needed"
    )
    assert error["message"].startswith(said)


def test_a_member_given_twice_is_refused(client):
    text = b'{"kind": "smooth", "model": "linear-2", "parameters": {"values": {"theta": 0, "theta": 1}}}'
    file = {"file": ("a.csv", b"y\n1\n2\n3\n")}
    for answer in (
        client.post("/jobs", content=text, headers=JSON),
        client.post("/jobs/upload", data={"request": text.decode()}, files=file),
    ):
        assert answer.status_code == 400
        assert "'theta' is there twice" in answer.json()["detail"]


def test_numbers_json_does_not_know(client, ended):
    """NaN is a missing measurement, as null is."""
    body = b'{"kind": "smooth", "model": "linear-2", "series": [{"y": [1.0, NaN, 1.2]}]}'
    answer = client.post("/jobs", content=body, headers=JSON)
    assert answer.status_code == 201
    assert ended(client, answer.headers["location"])["status"] == "successful"


def test_unknown_things_are_404_and_problems(client):
    for method, path in [
        ("GET", "/jobs/none"), ("DELETE", "/jobs/none"), ("POST", "/jobs/none/stop"),
        ("GET", "/jobs/none/trace"), ("GET", "/jobs/none/results"), ("GET", "/nothing"),
        ("GET", "/jobs/..%2f..%2fetc"),
    ]:  # fmt: skip
        answer = client.request(method, path)
        assert answer.status_code == answer.json()["status"] == 404, path
        assert answer.headers["content-type"] == "application/problem+json"
    assert client.get("/jobs/none").json()["type"].endswith("/no-such-job")
    assert client.put("/jobs").status_code == 405
    assert client.get("/jobs?limit=0").json()["errors"][0]["field"] == "query.limit"


def test_limits(make_client, estimation, long):
    client = make_client(max_body=5_000, max_queue=1, max_samples=50, max_series=2, workers=1)
    answer = client.post("/jobs", json=long)
    assert (answer.status_code, answer.json()["status"]) == (413, 413)

    def pieces():
        for _ in range(20):
            yield b" " * 1000

    as_json = {"Content-Type": "application/json"}
    assert client.post("/jobs", content=pieces(), headers=as_json).status_code == 413
    answer = client.post("/jobs", json=estimation())
    assert answer.json()["errors"][0]["field"] == "series[0]"
    small = estimation(iterations=10_000) | {"series": [{"y": [0.0, 1.0, 0.0]}] * 3}
    assert client.post("/jobs", json=small).json()["errors"][0]["field"] == "series"
    small["series"].pop()
    small["series"].pop()
    first = client.post("/jobs", json=small)
    assert first.status_code == 201
    full = client.post("/jobs", json=small)
    assert full.status_code == 429
    assert int(full.headers["retry-after"]) > 0
    client.post(f"{first.headers['location']}/stop")
    assert client.post("/jobs", json=small).status_code == 201


@pytest.mark.long
def test_studies_cost_no_more_than_allowed(make_client, estimation):
    """By what all runs together compute, not by their number."""
    client = make_client(max_cost=1e6, workers=1)
    samples = 60

    def post(**options):
        answer = client.post("/jobs", json=estimation(**options))
        if answer.status_code == 201:
            client.post(f"{answer.headers['location']}/stop")
            return None
        return answer.json()["errors"][0]

    most = int(1e6 / (samples * 5 * 40))  # 5 iterations, 20 particles and as many trajectories
    assert post(starts=most) is None
    error = post(starts=most + 1)
    assert (error["field"], f"allows {most} of that size" in error["message"]) == (
        "options.starts",
        True,
    )
    assert post(bootstrap=most)["field"] == "options.bootstrap"
    assert post(bootstrap=most - 1) is None
    assert post(starts=2, iterations=1000)["field"] == "options.starts"
    assert post(iterations=1000) is None  # one run is limited by its time
    assert post(method="rts-em", bootstrap=10 * most) is None


def test_one_run_is_no_bootstrap(client, estimation):
    answer = client.post("/jobs", json=estimation(bootstrap=1))
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["field"] == "options.bootstrap"
    assert error["message"] == "1 run shows no spread; 2 or more are needed, or 0 for none"


def test_settings_from_the_environment():
    settings = Settings.from_env({"RBPS_PORT": "81", "RBPS_STATE_DIR": "/x", "HOME": "/"})
    assert (settings.port, settings.store_url) == (81, "sqlite:////x/rbps.sqlite")
    with pytest.raises(ValueError, match="RBPS_PROT is not a setting"):
        Settings.from_env({"RBPS_PROT": "81"})
    with pytest.raises(ValueError, match="RBPS_PORT='x' is not of type int"):
        Settings.from_env({"RBPS_PORT": "x"})
    for wrong in ("workers = 0", "port = 99999", "max_queue_per_key = 1000"):
        name, _, value = wrong.partition(" = ")
        with pytest.raises(ValueError, match=wrong):
            Settings(**{name: int(value)})
