"""Large and unwanted bodies: refused before they are read, worked on without keeping others waiting."""

import json
import socket
import threading
import time

import httpx
import numpy as np
import pytest

from service.auth import digest_of
from service.strict_json import PART, dumps

HEAD = b"POST %s HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: %d\r\n"
ARRAY = b'{"kind":"estimate","model":"local-level","series":[{"y":[%s]}]}'


class Raw(socket.socket):
    """A connection to a service, as bytes."""

    def __init__(self, served):
        super().__init__()
        self.settimeout(60)
        self.connect(("127.0.0.1", served.port))

    def until(self, mark):
        """What comes up to and including ``mark``."""
        found = b""
        while mark not in found:
            more = self.recv(65536)
            assert more, f"closed after {found!r}"
            found += more
        return found


@pytest.fixture
def keyed(make_client, tmp_path):
    (tmp_path / "keys").write_text(f"anna {digest_of('key')}\n")
    return make_client(keys_file=tmp_path / "keys")


@pytest.mark.long
@pytest.mark.parametrize("path", [b"/jobs", b"/jobs/upload", b"/preview", b"/models/extend"])
@pytest.mark.parametrize("key", [b"", b"X-API-Key: another\r\n"])
def test_who_has_no_key_is_told_so_before_the_body_is_sent(keyed, path, key):
    with Raw(keyed) as raw:
        raw.sendall(HEAD % (path, 60 << 20) + key + b"\r\n")
        assert raw.until(b"\r\n").startswith(b"HTTP/1.1 401")


def test_other_requests_are_answered_while_a_large_body_is_worked_on(client):
    """By the order of answers: /livez, asked after the whole body was sent, is answered before it."""
    body = ARRAY % b",".join([b"1"] * 950_000)  # too many samples, within the numbers allowed
    # a connection that is there already: making one takes longer than the body
    with Raw(client) as raw, httpx.Client(base_url=client.base_url, timeout=60) as other:
        assert other.get("/livez").status_code == 200
        raw.sendall(HEAD % (b"/jobs", len(body)) + b"\r\n" + body)
        assert other.get("/livez").status_code == 200
        raw.setblocking(False)
        with pytest.raises(BlockingIOError):
            raw.recv(1, socket.MSG_PEEK)
        raw.settimeout(60)
        answer = raw.until(b"this service allows")
        assert answer.startswith(b"HTTP/1.1 422")
        assert b"samples in all series" in answer


@pytest.mark.parametrize(
    "made",
    [
        lambda: ARRAY % b",".join([b"1"] * 1_100_000),
        lambda: b'{"a":[' + b",".join([b"[]"] * 1_000_000) + b"]}",
        lambda: b"{" + b",".join(b'"%d":1' % i for i in range(30_000)) + b"}",
    ],
    ids=["numbers", "lists", "members"],
)
def test_what_no_job_can_hold_is_refused_before_it_is_parsed(client, monkeypatch, made):
    body = made()

    def parsed(*_):
        raise AssertionError("it was parsed")

    monkeypatch.setattr(json, "loads", parsed)
    answer = client.post("/jobs", content=body, headers={"Content-Type": "application/json"})
    monkeypatch.undo()
    assert (answer.status_code, answer.json()["title"]) == (413, "body too large")
    assert "more than the" in answer.json()["detail"]


def test_one_mistake_is_told_of_a_list_that_is_wrong_throughout(client):
    request = {"kind": "smooth", "model": "linear-2", "series": [{"y": [1.0, 2.0], "t": ["a"] * 9}]}
    for wrong in (request, request | {"series": [1] * 9}):
        assert len(client.post("/jobs", json=wrong).json()["errors"]) == 1


def test_large_bodies_take_turns(client, estimation, monkeypatch):
    """Memory is needed for one at a time, however many come at once."""
    at_once, most, found = [], [], []

    def watched(body):
        at_once.append(body)
        most.append(len(at_once))
        time.sleep(0.05)
        at_once.pop()
        return json.loads(body)

    monkeypatch.setattr("service.bodies.loads", watched)
    padded = json.dumps(estimation(iterations=1)).encode() + b" " * (2 << 20)

    def post():
        headers = {"Content-Type": "application/json"}
        found.append(client.post("/jobs", content=padded, headers=headers).status_code)

    threads = [threading.Thread(target=post) for _ in range(5)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert found == [201] * 5
    assert max(most) == 1


def test_files_of_more_numbers_than_a_job_may_hold(client, make_client):
    request = json.dumps({"kind": "smooth", "model": "linear-2"})
    small = make_client(max_values=1000)
    for served, name, data in (
        (client, "a.csv", b"y\n" + b"1\n" * 1_100_000),
        (small, "a.csv", b"y;x\n" + b"1;2\n" * 600),
        (small, "a.dat", b"y x\n" + b"1   2\n" * 600),
    ):
        for path, more in (("/jobs/upload", {"request": request}), ("/preview", {})):
            answer = served.post(path, data=more, files={"file": (name, data)})
            assert answer.status_code == 422, path
            assert "cells allowed here" in answer.json()["detail"]


def test_a_refusal_is_read_by_a_client_that_closes_afterwards(make_client):
    """With unread bytes on the way a closed connection would be reset, and the answer lost."""
    client = make_client(max_body=1000)
    body = b" " * (8 << 20)
    with Raw(client) as raw:
        raw.sendall(HEAD % (b"/jobs", len(body)) + b"Connection: close\r\n\r\n" + body)
        assert raw.until(b"body is larger").startswith(b"HTTP/1.1 413")
        while raw.recv(65536):
            pass


def test_bodies_on_their_way_are_limited_together(make_client):
    client = make_client(max_body=1 << 20)
    open_ = [Raw(client) for _ in range(5)]
    try:
        for raw in open_:
            raw.sendall(HEAD % (b"/jobs", 1_000_000) + b"\r\n" + b" " * 999_000)
        refused = []
        while not refused:  # which of them is the one too many, is its own affair
            for raw in open_:
                raw.settimeout(0.1)
                try:
                    refused.append(raw.recv(1000))
                except TimeoutError:
                    continue
        assert refused[0].startswith(b"HTTP/1.1 503")
        assert b"retry-after" in refused[0].lower()
    finally:
        for raw in open_:
            raw.close()


def test_an_encoded_body_is_refused(client):
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    answer = client.post("/jobs", content=b"\x1f\x8b", headers=headers)
    assert (answer.status_code, answer.headers["accept-encoding"]) == (415, "identity")


@pytest.mark.long
@pytest.mark.parametrize(
    "value",
    [
        {"y": np.arange(3.0 * PART).reshape(-1, 1).tolist(), "n": None, 'a "b"': [{"c": float("nan")}]},
        {"t": [float("inf"), 1.5] * PART, "empty": [], "none": {}, "text": "\u2028", "pairs": [(1, 2)]},
        [[1, [2, {"3": 4}]], {}],
        {1: 2},
    ],
)  # fmt: skip
def test_long_lists_are_written_as_the_library_would(value):
    def finite(item):
        if isinstance(item, float) and not np.isfinite(item):
            return None
        if isinstance(item, dict):
            return {k: finite(v) for k, v in item.items()}
        return [finite(v) for v in item] if isinstance(item, list | tuple) else item

    assert dumps(value) == json.dumps(finite(value), separators=(",", ":"))
