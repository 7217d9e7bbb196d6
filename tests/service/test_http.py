"""The manners of HTTP: conditional requests, repeats, keys, uploads, readiness, metrics."""

import contextlib
import io
import json
import os
import socket
import time
import zipfile
from csv import field_size_limit

import numpy as np
import pytest

from service.auth import digest_of
from service.settings import Settings


@pytest.fixture
def finished(client, estimation, ended):
    url = client.post("/jobs", json=estimation()).headers["location"]
    ended(client, url)
    return url


@pytest.mark.parametrize("part", ["", "/trace", "/results"])
def test_etags(client, finished, part):
    first = client.get(finished + part)
    again = client.get(finished + part, headers={"If-None-Match": f'"x", {first.headers["etag"]}'})
    assert (again.status_code, again.content) == (304, b"")
    weak = client.get(finished + part, headers={"If-None-Match": f"W/{first.headers['etag']}"})
    assert weak.status_code == 304  # as a proxy makes it that compresses
    other = client.get(finished + part, headers={"If-None-Match": '"x"'})
    assert (other.status_code, other.content) == (200, first.content)


@pytest.mark.parametrize("path", ["/", "/jobs", "/models", "/livez", "/examples/nile.csv"])
def test_head_is_get_without_a_body(client, path):
    whole, head = client.get(path), client.head(path)
    assert (head.status_code, head.content) == (200, b"")
    for name in ("content-type", "content-length"):
        assert head.headers[name] == whole.headers[name]


def test_allow_names_every_method_of_an_address(client):
    for verb, path, allowed in (
        ("PUT", "/jobs", "GET, HEAD, POST"),
        ("POST", "/jobs/x", "DELETE, GET, HEAD, PATCH"),
        ("DELETE", "/jobs", "GET, HEAD, POST"),
        ("GET", "/jobs/x/resume", "POST"),
        ("DELETE", "/jobs/x/stop", "POST"),
        ("HEAD", "/preview", "POST"),
        ("POST", "/livez", "GET, HEAD"),
    ):
        answer = client.request(verb, path)
        assert (answer.status_code, answer.headers["allow"]) == (405, allowed), path


def test_retry_after_while_there_is_something_to_wait_for(client, long, finished):
    url = client.post("/jobs", json=long).headers["location"]
    assert client.get(url).headers["retry-after"] == "1"
    assert client.get(f"{url}/results").headers["retry-after"] == "1"
    client.post(f"{url}/stop")
    assert "retry-after" not in client.get(finished).headers


def test_idempotency_key(client, estimation):
    headers = {"Idempotency-Key": "a key"}
    first = client.post("/jobs", json=estimation(), headers=headers)
    again = client.post("/jobs", json=estimation(), headers=headers)
    assert again.status_code == 201
    assert again.json()["jobID"] == first.json()["jobID"]
    other = client.post("/jobs", json=estimation(seed=99), headers=headers)
    assert (other.status_code, "idempotency" in other.json()["type"]) == (422, True)
    assert first.json()["jobID"] in other.json()["detail"]


def test_thinning_keeps_the_extremes(client, ended):
    y = [[0.0]] * 500
    y[123], y[321] = [40.0], [-40.0]
    request = {
        "kind": "simulate",
        "model": "linear-2",
        "series": [{"y": y}],
        "options": {"seed": 4},
    }
    url = client.post("/jobs", json=request).headers["location"]
    ended(client, url)
    whole = client.get(f"{url}/results").json()["simulation"]["series"][0]
    thin = client.get(f"{url}/results?points=60").json()["simulation"]["series"][0]
    assert 20 < len(thin["t"]) <= 60
    assert thin["t"][0] == 0.0
    assert thin["t"][-1] == 499.0
    for name in ("a", "z"):
        assert min(thin["states"][name]) == min(whole["states"][name])
        assert max(thin["states"][name]) == max(whole["states"][name])
    pairs = dict(zip(whole["t"], whole["y"]["y"], strict=True))
    assert all(pairs[t] == value for t, value in zip(thin["t"], thin["y"]["y"], strict=True))


@pytest.mark.long
def test_a_model_with_a_long_name(client, estimation):
    """Of more than 200 characters; also before the first estimate names its parameters."""
    states = ("colored", "coulomb", "cubic", "deadzone", "drag", "hysteresis", "stribeck")
    outputs = ("saturation-sensor", "cubic-sensor", "quantisation", "harmonic", "heavy-tails")
    effects = [f"{kind}:{at}" for kind in states for at in "az"]
    effects += [f"{kind}:y" for kind in outputs]
    model = {"name": "linear-2", "with": effects}
    assert len("+".join(["linear-2", *effects])) > 200
    answer = client.post("/jobs", json=estimation(particles=5000) | {"model": model})
    assert answer.status_code == 201, answer.text
    url = answer.headers["location"]
    for path in ("", "/trace", "/tasks", "/request"):
        assert client.get(url + path).status_code == 200, path
    client.post(f"{url}/stop")
    for path in ("/trace", "/results"):
        assert client.get(url + path).status_code in (200, 404), path


def test_thin_trace(client, estimation, ended):
    url = client.post("/jobs", json=estimation(method="rts-em", iterations=25)).headers["location"]
    ended(client, url)
    trace = client.get(f"{url}/trace?points=10").json()
    assert 4 <= len(trace["iteration"]) <= 10
    assert trace["iteration"][0] == 0
    assert len(trace["theta"]["theta"]) == len(trace["iteration"])


def csv(rows):
    return "\n".join([",".join(map(str, row)) for row in rows]).encode()


def npz(**arrays):
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def mat(**arrays):
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, arrays, do_compression=True)
    return stream.getvalue()


def post_files(client, request, *files):
    parts = [("file", (name, data)) for name, data in files]
    return client.post("/jobs/upload", data={"request": json.dumps(request)}, files=parts)


@pytest.mark.long
def test_uploads_compute_what_json_does(client, ended, data):
    y = np.array(data)
    base = {"kind": "smooth", "model": "linear-2", "options": {"particles": 30, "seed": 1}}
    rows = [["level", "time"], *([v, 2.0 * i] for i, (v,) in enumerate(data))]
    named = {"file": "a.csv", "y": {"y": "level"}, "t": "time"}
    t = 2.0 * np.arange(len(y))
    posts = [
        client.post("/jobs", json=base | {"series": [{"y": data, "dt": 2.0}]}),
        post_files(client, base | {"series": [named]}, ("a.csv", csv(rows))),
        post_files(client, base, ("b.npz", npz(y=y, t=t))),
        post_files(client, base, ("c.mat", mat(y=y, t=t[:, None]))),
    ]
    found = []
    for answer in posts:
        assert answer.status_code == 201, answer.text
        assert ended(client, answer.headers["location"])["status"] == "successful"
        found.append(client.get(f"{answer.headers['location']}/results").json())
    assert [one.pop("data") for one in found] == [[], ["a.csv"], ["b.npz"], ["c.mat"]]
    for one in found:
        one.pop("created")
    assert found[1] == found[2] == found[3] == found[0]


def test_several_files_are_several_series(client, ended, data):
    files = [(f"{i}.csv", csv([["y"], *data])) for i in range(3)]
    answer = post_files(client, {"kind": "smooth", "model": "linear-2"}, *files)
    assert ended(client, answer.headers["location"])["status"] == "successful"
    found = client.get(f"{answer.headers['location']}/results").json()
    assert len(found["states"]["series"]) == 3


def test_a_name_as_browsers_send_it(client, data):
    """They write a quotation mark in it as %22; who sends %22 itself means that."""
    rows = csv([["y"], *data])
    for sent, asked in (("a %22b%22.csv", 'a "b".csv'), ("a%22.csv", "a%22.csv")):
        answer = post_files(client, BASE | {"series": [{"file": asked}]}, (sent, rows))
        assert answer.status_code == 201, answer.text
        assert client.get(f"{answer.headers['location']}/request").json()["data"] == [asked]
        client.post(f"{answer.headers['location']}/stop")
    shown = client.post("/preview", files={"file": ("a %22b%22.csv", rows)})
    assert shown.json()["file"] == 'a "b".csv'


def test_files_are_all_used_and_each_once(client, data):
    one, other = (csv([["y", "z"], *((y, n * y) for (y,) in data)]) for n in (1, 2))
    both = [("a.csv", one), ("b.csv", other)]
    answer = post_files(client, BASE | {"series": [FILE]}, *both)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["message"].startswith("no series names 'b.csv'")
    answer = post_files(client, BASE | {"series": [FILE, FILE]}, both[0])
    assert answer.json()["errors"][0] == {
        "field": "series[1].file", "message": "series[0] reads the same of 'a.csv': give each once",
    }  # fmt: skip
    columns = [FILE | {"y": ["y"]}, {"file": "b.csv", "y": ["z"]}, {"file": "b.csv", "y": ["y"]}]
    answer = post_files(client, BASE | {"series": columns}, *both)  # columns may be experiments
    assert answer.status_code == 201, answer.text
    client.post(f"{answer.headers['location']}/stop")


class Evil:
    def __reduce__(self):
        return os.system, ("touch /tmp/rbps-was-unpickled",)


BASE = {"kind": "smooth", "model": "linear-2"}
FILE = {"file": "a.csv"}


def claiming(rows):
    """An .npz whose header claims so many rows."""
    stored = zipfile.ZipFile(io.BytesIO(npz(y=np.zeros(1)))).read("y.npy")
    header = stored.replace(b"(1,), }" + b" " * (len(rows) - 1), f"({rows},), }}".encode())
    assert len(header) == len(stored)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("y.npy", header)
    return out.getvalue()


BAD = {
    "many rows": (BASE, "a.npz", claiming("1000000000000"), "claims 8000000000000 bytes"),
    "long cell": (BASE, "a.csv", b"y\n" + b"1" * 140_000, "line 2: a cell has more than 131072 characters"),
    "no such number": (BASE, "a.csv", b"y\n1_000\n2\n", "'1_000' is not a number"),
    "pickled npz": (BASE, "a.npz", npz(y=np.array([Evil()], dtype=object)), "not usable: 'y'"),
    "bomb": (BASE, "a.npz", npz(y=np.zeros(2_000_000)), "unpacks to more"),
    "mat bomb": (BASE, "a.mat", mat(y=np.zeros(2_000_000)), "unpacks to more"),
    "text": (BASE, "a.csv", csv([["y"], ["1"], ["x"]]), "line 3, column 'y'"),
    "encoding": (BASE, "a.csv", b"y\n1\n\x81\n", "UTF-8"),
    "path": (BASE, "../../etc/passwd", b"root", "must be .csv"),
    "no column": (BASE, "a.csv", csv([["q", "r"], ["1", "1"]]), "no column is channel 'y'"),
    "no such column": (BASE | {"series": [FILE | {"y": ["q"]}]}, "a.csv", b"y\n1\n2\n", "no column 'q'"),
    "two columns": (BASE | {"series": [FILE | {"y": ["y", "y"]}]}, "a.csv", b"y\n1\n2\n", "names 2"),
    "not there": (BASE | {"series": [{"file": "b.csv"}]}, "a.csv", b"", "no file 'b.csv'"),
    "unknown member": (BASE | {"series": [{"file": "a.csv", "x": 1}]}, "a.csv", b"", "series[0].x"),
    "wrong channel": (
        BASE | {"series": [FILE | {"y": {"q": "y"}}]}, "a.csv", b"y\n1\n2\n", "model's channels are y",
    ),
    "no kind": ({"model": "linear-2"}, "a.csv", b"y\n1\n2\n", "kind"),
    "bad option": (BASE | {"options": {"seed": "x"}}, "a.csv", b"y\n1\n2\n", "options.seed"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_uploads(client, name):
    request, filename, data, words = BAD[name]
    answer = post_files(client, request, (filename, data))
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert words in answer.json()["detail"]
    assert not os.path.exists("/tmp/rbps-was-unpickled")


@pytest.mark.parametrize("name", ["many rows", "long cell"])
def test_previews_of_files_that_are_not_what_they_seem(client, name):
    _, filename, data, words = BAD[name]
    answer = client.post("/preview", files={"file": (filename, data)})
    assert answer.status_code == 422
    assert words in answer.json()["detail"]


@pytest.mark.parametrize("limit", [200, 1 << 30])
def test_a_long_cell_is_refused_whatever_others_have_set_csv_to(client, limit):
    """Its limit is one of the process, which a plug-in may change."""
    request, filename, data, words = BAD["long cell"]
    usual = field_size_limit(limit)
    try:
        answer = post_files(client, request, (filename, data))
    finally:
        field_size_limit(usual)
    assert (answer.status_code, words in answer.json()["detail"]) == (422, True)


def test_two_files_of_one_name_are_told_apart_by_the_client(client, data):
    files = [("a.csv", csv([["y"], *data])), ("a.csv", csv([["y"], *data[:30]]))]
    answer = post_files(client, BASE, *files)
    assert answer.status_code == 422
    assert "two files are named 'a.csv'" in answer.json()["detail"]


def test_request_part_that_is_no_json(client):
    for text, status in (("{", 400), ("[" * 100_000, 400), ("[]", 422)):
        answer = client.post(
            "/jobs/upload", data={"request": text}, files={"file": ("a.csv", b"y")}
        )
        assert answer.status_code == status


def test_other_media_types(client):
    answer = client.post("/jobs", content=b"<x/>", headers={"Content-Type": "text/xml"})
    assert answer.status_code == 415


def test_keys(make_client, tmp_path, estimation):
    names = ("anna", "boris")
    file = tmp_path / "keys"
    file.write_text("# keys\n" + "".join(f"{n} {digest_of('key of ' + n)}\n" for n in names))
    client = make_client(keys_file=file, host="0.0.0.0", max_queue_per_key=1, workers=1)
    anna, boris = ({"X-API-Key": f"key of {name}"} for name in names)
    assert client.get("/livez").status_code == client.get("/readyz").status_code == 200
    for headers in ({}, {"X-API-Key": "key"}, {"Authorization": "Basic key of anna"}):
        answer = client.get("/jobs", headers=headers)
        assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
    assert client.post("/jobs", json=estimation()).status_code == 401
    slow = estimation(iterations=100_000, particles=500)
    made = client.post("/jobs", json=slow, headers=anna | {"Idempotency-Key": "k"})
    url = made.headers["location"]
    bearer = {"Authorization": "Bearer key of anna"}
    assert client.get(url, headers=bearer).status_code == 200
    for verb, path in (
        ("GET", ""),
        ("GET", "/trace"),
        ("GET", "/results"),
        ("DELETE", ""),
        ("POST", "/stop"),
    ):
        answer = client.request(verb, url + path, headers=boris)
        assert answer.json()["type"].endswith("no-such-job"), path
    assert client.get("/jobs", headers=boris).json()["jobs"] == []
    assert len(client.get("/jobs", headers=anna).json()["jobs"]) == 1
    assert client.post("/jobs", json=slow, headers=anna).status_code == 429
    again = client.post("/jobs", json=slow, headers=anna | {"Idempotency-Key": "k"})
    assert (again.status_code, again.headers["location"]) == (201, url)
    second = client.post("/jobs", json=slow, headers=boris)
    assert second.status_code == 201
    client.post(f"{url}/stop", headers=anna)
    client.post(f"{second.headers['location']}/stop", headers=boris)


def test_without_keys_only_loopback(make_client, tmp_path):
    with pytest.raises(ValueError, match=r"0\.0\.0\.0 can be reached .* RBPS_KEYS_FILE"):
        make_client(host="0.0.0.0")
    make_client(host="0.0.0.0", open_network=True)
    for wrong in ("key", "ä" * 64):  # bytes beyond ASCII could not be compared
        (tmp_path / "keys").write_text(f"anna {wrong}\n", "utf-8")
        with pytest.raises(ValueError, match="line 1: 'NAME SHA256'"):
            make_client(keys_file=tmp_path / "keys")
    assert Settings.from_env({"RBPS_OPEN_NETWORK": "yes"}).open_network


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no key"),
        ("# nobody yet\n\n", "holds no key"),
        (f"anna {'0' * 64}\nanna {'1' * 64}\n", "line 2: 'anna' is there twice"),
    ],
)
def test_a_keys_file_that_lets_everybody_in_or_somebody_out(make_client, tmp_path, text, words):
    (tmp_path / "keys").write_text(text)
    for host in ("127.0.0.1", "0.0.0.0"):
        with pytest.raises(ValueError, match=words):
            make_client(keys_file=tmp_path / "keys", host=host)


def test_a_body_that_stops_halfway(make_client):
    client = make_client(body_seconds=0.2)
    with socket.create_connection(("127.0.0.1", client.port)) as slow:
        slow.sendall(
            b"POST /jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        )
        slow.sendall(b"Content-Length: 100\r\n\r\n{")
        slow.settimeout(60.0)
        answer = b""
        while b"paused for more than 0.2 s" not in answer:
            more = slow.recv(1000)
            assert more, answer
            answer += more
        assert answer.startswith(b"HTTP/1.1 408")


@pytest.mark.slow
def test_a_body_that_trickles(make_client):
    """No pause is too long, but all together are; where this process was kept waiting, it tries again."""
    client = make_client(body_seconds=0.3)
    for _ in range(20):
        answer = _trickled(client.port)
        if b"paused" not in answer:
            break
    assert b"longer than 6 s" in answer


def _trickled(port):
    """What a client is answered that sends a blank twenty times a second."""
    with socket.create_connection(("127.0.0.1", port)) as slow:
        slow.sendall(
            b"POST /jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        )
        slow.sendall(b"Content-Length: 100000\r\n\r\n")
        slow.settimeout(0.05)
        begin = time.monotonic()
        answer = b""
        while not answer:
            assert time.monotonic() - begin < 600.0
            slow.sendall(b" ")
            with contextlib.suppress(TimeoutError):
                answer = slow.recv(1000)
        assert answer.startswith(b"HTTP/1.1 408")
        slow.settimeout(60.0)
        while more := slow.recv(1000):
            answer += more
        return answer


def test_metrics_and_readiness(client, finished):
    assert client.get("/readyz").json() == {"status": "ready"}
    text = client.get("/metrics").text
    lines = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert float(lines['rbps_jobs{status="successful"}']) >= 1
    assert float(lines["rbps_workers"]) == 2
    assert float(lines["rbps_iterations_total"]) >= 5
    assert float(lines['rbps_job_seconds_sum{kind="estimate",status="successful"}']) > 0


def test_readyz_tells_the_truth(make_client):
    client = make_client()
    assert client.get("/readyz").status_code == 200
    client.app.state.supervisor.stop()
    assert client.get("/readyz").status_code == 503
    assert client.get("/livez").status_code == 200


@pytest.mark.long
def test_drain_on_shutdown(make_client, estimation, wait):
    client = make_client(drain=True, workers=1)
    url = client.post("/jobs", json=estimation(iterations=40)).headers["location"]
    wait(client, url, lambda job: job["iteration"] >= 1)
    client.stop()
    again = make_client()
    assert again.get(url).json()["status"] == "successful"


@pytest.mark.long
def test_run_seconds_of_a_job(client, long, ended, wait):
    url = client.post("/jobs", json=long | {"run_seconds": 0.5}).headers["location"]
    job = ended(client, url)
    assert (job["status"], "0.5 s" in job["message"]) == ("failed", True)
    assert client.post(f"{url}/resume", json={"run_seconds": 0.0}).status_code == 422
    assert client.post(f"{url}/resume", json={"run_seconds": 3600.0}).json()["status"] == "accepted"
    wait(client, url, lambda job: job["iteration"] >= 2)
    client.post(f"{url}/stop")
