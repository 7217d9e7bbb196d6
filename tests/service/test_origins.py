"""Pages of others, in a browser on this machine, can neither read nor change anything."""

import json

import pytest

from service.auth import digest_of

REQUEST = {"request": json.dumps({"kind": "smooth", "model": "linear-2"})}
FILES = {"file": ("a.csv", b"y\n1\n2\n")}


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8000", "localhost.evil.example", "", "[::1", "10.0.0.1"]
)
def test_names_of_others_are_not_answered(client, host):
    for method, path in (
        ("GET", "/"),
        ("GET", "/jobs"),
        ("DELETE", "/jobs/none"),
        ("POST", "/jobs/none/stop"),
        ("GET", "/livez"),
    ):
        answer = client.request(method, path, headers={"Host": host})
        assert (answer.status_code, answer.json()["title"]) == (421, "foreign host"), path


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:1", "127.0.0.1:8000", "127.1.2.3", "[::1]:80", "a.localhost"]
)
def test_names_of_this_machine_are_answered(client, host):
    assert client.get("/jobs", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://localhost:1", "https://127.0.0.1.evil.example", "x"],
)
def test_pages_of_others_change_nothing(client, origin, estimation):
    headers = {"Origin": origin}
    before = client.get("/jobs").json()["jobs"]
    for answer in (
        client.post("/jobs/upload", data=REQUEST, files=FILES, headers=headers),
        client.post("/jobs", json=estimation(), headers=headers),
        client.delete("/jobs/none", headers=headers),
    ):
        assert (answer.status_code, answer.json()["title"]) == (403, "foreign origin")
    assert client.get("/jobs", headers=headers).json()["jobs"] == before
    assert "access-control-allow-origin" not in client.get("/jobs", headers=headers).headers


def test_its_own_pages_do(client):
    own = {"Origin": str(client.base_url).rstrip("/")}
    answer = client.post("/jobs/upload", data=REQUEST, files=FILES, headers=own)
    assert answer.status_code == 201
    assert client.post(f"{answer.headers['location']}/stop", headers=own).status_code == 200


def test_further_names(make_client):
    named = make_client(hosts="lab.example, other.example")
    for origin in ("https://lab.example", "https://lab.example:444"):
        headers = {"Host": "lab.example", "Origin": origin}
        assert named.delete("/jobs/none", headers=headers).status_code == 404
    assert named.get("/jobs", headers={"Host": "evil.example"}).status_code == 421
    open_ = make_client(host="0.0.0.0", open_network=True)
    assert open_.get("/jobs", headers={"Host": "any.example"}).status_code == 200
    assert open_.delete("/jobs/none", headers={"Origin": "http://evil.example"}).status_code == 403
    guarded = make_client(host="0.0.0.0", open_network=True, hosts="lab.example")
    assert guarded.get("/jobs", headers={"Host": "any.example"}).status_code == 421


def test_a_key_is_proof_enough(make_client, tmp_path):
    (tmp_path / "keys").write_text(f"anna {digest_of('key')}\n")
    client = make_client(keys_file=tmp_path / "keys")
    headers = {"Host": "any.example", "Origin": "https://proxy.example", "X-API-Key": "key"}
    assert client.delete("/jobs/none", headers=headers).status_code == 404
