"""Connections: those that wait are closed, and never keep others from being answered."""

import contextlib
import logging
import signal
import socket

import pytest

from service.logs import Sparse
from service.server import OTHER_FILES
from service.settings import Settings

BEGIN = b"POST /jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
WAITING = {
    "nothing": b"",
    "half of the headers": BEGIN,
    "half of a body": BEGIN + b"Content-Length: 9\r\n\r\n{",
}


def connect(port, sent=b""):
    made = socket.create_connection(("127.0.0.1", port), 60)
    made.sendall(sent)
    return made


def ends(connection):
    """Whether the other side closes the connection, whatever it sends before."""
    with contextlib.suppress(ConnectionResetError):
        while connection.recv(65536):
            pass
    return True


@pytest.mark.long
@pytest.mark.parametrize("sent", ["nothing", "half of the headers"])
def test_a_connection_without_a_request_is_closed(make_client, sent):
    client = make_client(header_seconds=0.2)
    with connect(client.port, WAITING[sent]) as waiting:
        assert ends(waiting)


def test_headers_that_trickle_have_no_longer(make_client):
    client = make_client(header_seconds=0.3)
    with connect(client.port, BEGIN) as slow, pytest.raises(ConnectionError):
        trickle(slow)


def trickle(slow):
    slow.settimeout(0.02)
    while True:
        slow.sendall(b"X: y\r\n")
        with contextlib.suppress(TimeoutError):
            if not slow.recv(100):
                raise ConnectionError


def test_a_second_request_has_no_longer(make_client, monkeypatch):
    """Nor is a body waited for that was answered before its end."""
    monkeypatch.setattr("service.limits.LINGER_SECONDS", 0.1)
    client = make_client(header_seconds=0.5, max_body=100)
    with connect(client.port, b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n") as used:
        assert used.recv(65536).startswith(b"HTTP/1.1 200")
        used.sendall(b"GET /livez HTTP/1.1\r\n")
        assert ends(used)
    with connect(
        client.port, BEGIN + b"Connection: close\r\nContent-Length: 1000\r\n\r\n{"
    ) as used:
        assert used.recv(65536).startswith(b"HTTP/1.1 413")
        assert ends(used)


def test_a_client_may_come_back_as_late_as_it_may_come(make_client):
    """httpx and others reuse a connection for 5 s; one that is closed then resets their request."""
    assert Settings().header_seconds > 5
    client = make_client(header_seconds=6.5)
    assert client.server.config.timeout_keep_alive == 7
    soon = make_client(header_seconds=0.5)
    with connect(soon.port, b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n") as used:
        assert used.recv(65536).startswith(b"HTTP/1.1 200")
        assert ends(used)


@pytest.mark.long
def test_who_does_not_read_the_answer_is_left(make_client, eventually):
    client = make_client(body_seconds=0.2)
    ask = b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with connect(client.port, 300 * ask):
        eventually(lambda: client.server.server_state.total_requests)
        eventually(lambda: not client.server.server_state.connections)


@pytest.mark.parametrize("sent", WAITING)
def test_others_are_answered_whoever_waits(make_client, sent):
    """Beyond the limit the one that was silent longest goes."""
    client = make_client(max_connections=10, header_seconds=1000.0, body_seconds=1000.0)
    waiting = [connect(client.port, WAITING[sent]) for _ in range(30)]
    try:
        for _ in range(20):
            with connect(client.port, b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n") as one:
                assert one.recv(65536).startswith(b"HTTP/1.1 200")
        assert len(client.server.server_state.connections) <= 11
        assert ends(waiting[0])
    finally:
        for one in waiting:
            one.close()


@pytest.mark.slow
def test_few_files_are_enough(spawn):
    """More connections than the service may have open files; and what it writes about it."""
    files = ["sh", "-c", f'ulimit -n {OTHER_FILES + 100}; exec "$@"', "sh"]
    service = spawn(before=files, header_seconds=1000)
    waiting = [connect(service.port) for _ in range(260)]
    try:
        for _ in range(5):
            service.client.close()
            with connect(service.port, b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n") as one:
                assert one.recv(65536).startswith(b"HTTP/1.1 200")
    finally:
        for one in waiting:
            one.close()
    assert len((service.state / "log").read_text().splitlines()) < 200


@pytest.mark.slow
@pytest.mark.parametrize("sent", WAITING)
def test_a_stop_does_not_wait_for_what_may_never_come(spawn, sent):
    """By far: the client has thousands of seconds for each pause."""
    service = spawn(body_seconds=5000, header_seconds=5000)
    with connect(service.port, WAITING[sent]) as waiting:
        service.client.get("/livez")
        service.process.send_signal(signal.SIGTERM)
        assert service.process.wait(300) in (0, -signal.SIGTERM)
        assert ends(waiting)


def test_warnings_that_repeat_are_counted_and_not_written(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    sparse = Sparse(most=2, seconds=60.0)

    def passes(text, *arguments, level=logging.WARNING):
        record = logging.LogRecord("uvicorn", level, "x.py", 1, text, arguments, None)
        return record.getMessage() if sparse.filter(record) else None

    assert [passes("from %s", i) for i in range(4)] == ["from 0", "from 1", None, None]
    assert passes("another") == "another"
    assert all(passes("done %s", i, level=logging.INFO) for i in range(9))
    now[0] = 61.0
    assert passes("from %s", 5) == "from 5 (2 more like this were not written)"
    assert [passes("from %s", i) for i in range(2)] == ["from 0", None]
