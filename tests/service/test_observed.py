"""What an operator sees from outside: the log's lines and the metrics."""

import json
import re
import time
from datetime import datetime

import pytest

FAILS = {
    "kind": "simulate", "model": "mixed-4", "options": {"mode": "stochastic", "samples": 5000},
    "parameters": {"values": {"theta_4": 1.2}},
}  # fmt: skip
METRICS = {
    "rbps_jobs": "gauge",
    "rbps_queue_age_seconds": "gauge",
    "rbps_workers": "gauge",
    "rbps_workers_busy": "gauge",
    "rbps_iterations_total": "counter",
    "rbps_job_seconds": "summary",
    "rbps_failures_total": "counter",
}


def samples(text):
    """{name{labels}: value}; every line is as the exposition format has it."""
    assert text.endswith("\n")
    found, types = {}, {}
    for line in text.splitlines():
        if line.startswith("# TYPE "):
            _, _, name, kind = line.split()
            types[name] = kind
        elif not line.startswith("# HELP "):
            match = re.fullmatch(
                r'([a-z_]+(?:\{[a-z]+="[^"]*"(?:,[a-z]+="[^"]*")*\})?) (\S+)', line
            )
            assert match, line
            found[match[1]] = float(match[2])
    assert types == METRICS
    return found


@pytest.mark.slow
def test_metrics_of_queue_workers_durations_iterations_and_failures(
    make_client, estimation, long, ended, wait
):
    client = make_client(workers=1)
    before = samples(client.get("/metrics").text)
    assert (before["rbps_workers"], before["rbps_workers_busy"]) == (1, 0)
    failed = client.post("/jobs", json=FAILS).headers["location"]
    done = client.post("/jobs", json=estimation(iterations=7)).headers["location"]
    for url in (failed, done):
        ended(client, url)
    running = client.post("/jobs", json=long).headers["location"]
    waiting = client.post("/jobs", json=estimation()).headers["location"]
    wait(client, running, lambda job: job["iteration"] >= 1)
    first = samples(client.get("/metrics").text)
    assert first['rbps_jobs{status="running"}'] == first['rbps_jobs{status="accepted"}'] == 1
    assert first["rbps_workers_busy"] == 1
    assert first["rbps_queue_age_seconds"] > 0
    assert first['rbps_failures_total{cause="computation-failed"}'] == 1
    assert first['rbps_job_seconds_count{kind="estimate",status="successful"}'] == 1
    job = client.get(done).json()
    took = datetime.fromisoformat(job["finished"]) - datetime.fromisoformat(job["started"])
    seconds = first['rbps_job_seconds_sum{kind="estimate",status="successful"}']
    assert abs(seconds - took.total_seconds()) < 0.002
    # iterations per second are the counter's rate; it goes on while a job runs
    wait(client, running, lambda job: job["iteration"] >= 3)
    second = samples(client.get("/metrics").text)
    assert second["rbps_iterations_total"] >= first["rbps_iterations_total"] + 1 >= 7
    client.post(f"{waiting}/stop")
    client.post(f"{running}/stop")


@pytest.mark.slow
def test_each_line_of_the_log_is_json_and_names_the_job(spawn, estimation, ended):
    service = spawn()
    urls = [
        service.client.post("/jobs", json=estimation(seed=i)).headers["location"] for i in (1, 2)
    ]
    urls.append(service.client.post("/jobs", json=FAILS).headers["location"])
    for url in urls:
        ended(service.client, url)
    service.stop()
    lines = [json.loads(line) for line in (service.state / "log").read_text().splitlines()]
    assert all({"time", "level", "logger", "message"} <= set(line) for line in lines)
    now = time.time()
    assert all(abs(datetime.fromisoformat(line["time"]).timestamp() - now) < 3600 for line in lines)
    for url in urls:
        said = [line["message"] for line in lines if line.get("job") == url.removeprefix("/jobs/")]
        assert sum(text.startswith("attempt started, process ") for text in said) == 1
        assert sum(text == "attempt ended, exit code 0" for text in said) == 1
        assert sum("result is written" in text for text in said) == (url is not urls[-1])
    assert any("job" not in line for line in lines)  # the service's own
