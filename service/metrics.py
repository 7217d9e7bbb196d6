"""Prometheus text: what the store counts, and the workers. Counters survive a restart."""

from __future__ import annotations

from collections.abc import Iterable

from service.store import Store
from service.supervisor import Supervisor


def text(store: Store, supervisor: Supervisor) -> str:
    """The exposition format, version 0.0.4."""
    found = store.statistics()
    out: list[str] = []

    def add(name: str, kind: str, about: str, samples: Iterable[tuple[str, float]]) -> None:
        out.append(f"# HELP rbps_{name} {about}\n# TYPE rbps_{name} {kind}")
        for suffix, value in samples:
            out.append(f"rbps_{name}{suffix} {value:.10g}")

    statuses = ((f'{{status="{s}"}}', n) for s, n in sorted(store.counts().items()))
    add("jobs", "gauge", "Jobs by status.", statuses)
    add("queue_age_seconds", "gauge", "Age of the oldest waiting job.", [("", found["waiting"])])
    add("workers", "gauge", "Attempts that may run at once.", [("", supervisor.capacity())])
    add("workers_busy", "gauge", "Attempts that run.", [("", supervisor.running())])
    add("iterations_total", "counter", "Iterations done.", [("", found["iterations"])])
    durations = []
    for kind, status, n, seconds in found["durations"]:
        labels = f'{{kind="{kind}",status="{status}"}}'
        durations += [(f"_count{labels}", n), (f"_sum{labels}", seconds)]
    add("job_seconds", "summary", "From start to end of jobs.", durations)
    causes = ((f'{{cause="{cause}"}}', n) for cause, n in found["causes"])
    add("failures_total", "counter", "Failed jobs by cause.", causes)
    return "\n".join(out) + "\n"
