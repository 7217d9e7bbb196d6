"""``make large-bodies``: what one large body costs, and what it costs the others; before and after.

    python -m tests.benchmarks.large_bodies [--results FOLDER]

Each body is sent to a fresh service; meanwhile another client asks ``/livez`` again and again. Writes
``service-large-bodies.md``: when the body was answered, the slowest ``/livez``, and the most memory.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from service.auth import digest_of
from tests.benchmarks.machine import Watch
from tests.benchmarks.service_process import ServiceProcess

RESULTS = Path(__file__).parent / "results"
SIZE = 60 << 20
LIVEZ_SECONDS, MEMORY_MB = 1.0, 700.0  # what is asked


def array(values: int) -> bytes:
    """An estimation on so many ones."""
    ones = b",".join([b"1"] * values)
    return b'{"kind":"estimate","model":"local-level","series":[{"y":[%s]}]}' % ones


@dataclass(frozen=True)
class Body:
    """What is sent, where, and whether a key is needed for it."""

    content: bytes
    path: str = "/jobs"
    media: str = "application/json"
    keyed: bool = False


def bodies() -> dict[str, Body]:
    """By what they are."""
    table = {"y": [[i % 7 + 0.123456789012] * 2 for i in range(200_000)]}
    largest = {"kind": "smooth", "model": "mixed-4", "series": [table]}
    channels = {f"c{k}": [i % 5 + 0.1 * k for i in range(70_000)] for k in range(11)}
    wide = {"y": [[float(i % 7)] for i in range(70_000)], "extra": channels}
    asks = {"kind": "diagnose", "model": "linear-2", "series": [wide]}
    lines = "".join(f"{i % 7 + 0.123456789012},{i % 5}.5\n" for i in range(200_000))
    empty_lists = b'{"a":[' + b",".join([b"[]"] * (SIZE // 3)) + b"]}"
    return {
        "60 MiB of numbers": Body(array(SIZE // 2)),
        "60 MiB of empty lists, no key where one is needed": Body(empty_lists, keyed=True),
        "as many numbers as are allowed, too many samples": Body(array(999_000)),
        "the most samples that are allowed, accepted": Body(json.dumps(largest).encode()),
        "as many numbers as are allowed, accepted": Body(json.dumps(asks).encode()),
        "a file of the most samples, accepted": form("a,b\n" + lines),
        "60 MiB of line ends as a file": form("\r\n" * (SIZE // 2)),
    }


def form(text: str) -> Body:
    """An upload of a file for mixed-4, whose first column is its first output."""
    asked = {"kind": "smooth", "model": "mixed-4", "series": [{"file": "a.csv", "y": ["a", "b"]}]}
    parts = [
        'Content-Disposition: form-data; name="request"\r\n\r\n' + json.dumps(asked),
        'Content-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n' + text,
    ]
    content = "".join(f"--xyz\r\n{part}\r\n" for part in parts) + "--xyz--\r\n"
    return Body(content.encode(), "/jobs/upload", "multipart/form-data; boundary=xyz")


def peak_mb(pid: int) -> float:
    """The most memory the process had so far."""
    status = Path(f"/proc/{pid}/status").read_text()
    return float(next(line.split()[1] for line in status.splitlines() if "VmHWM" in line)) / 1024


def measure(body: Body) -> dict[str, Any]:
    """One body, one service."""
    with tempfile.TemporaryDirectory(prefix="rbps-large-") as state:
        more = {}
        if body.keyed:
            (Path(state) / "keys").write_text(f"anna {digest_of('key')}\n")
            more["keys_file"] = f"{state}/keys"
        service = ServiceProcess(Path(state), workers=1, **more)
        done, times = threading.Event(), []

        def ask() -> None:
            with httpx.Client(base_url=service.url, timeout=600) as http:
                while not done.is_set():
                    begin = time.perf_counter()
                    http.get("/livez").raise_for_status()
                    times.append(time.perf_counter() - begin)
                    time.sleep(0.01)

        time.sleep(3.0)
        before = peak_mb(service.process.pid)
        others = threading.Thread(target=ask)
        others.start()
        begin = time.perf_counter()
        answer = httpx.post(
            service.url + body.path,
            content=body.content,
            headers={"Content-Type": body.media},
            timeout=600,
        )
        took = time.perf_counter() - begin
        done.set()
        others.join()
        found = {
            "status": answer.status_code,
            "seconds": took,
            "livez": max(times),
            "before": before,
            "peak": peak_mb(service.process.pid),
        }
        service.stop()
    return found


def main() -> None:
    """Run, print, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS)
    chosen = parser.parse_args()
    with Watch() as machine:
        found = {name: measure(one) for name, one in bodies().items()}
    lines = [
        "# One large body",
        "",
        "`make large-bodies`: each to a fresh service, while another client asks `/livez` again and "
        f"again. Asked are `/livez` within {LIVEZ_SECONDS:g} s and less than {MEMORY_MB:g} MB. Before "
        "bodies were counted as they arrive and parsed beside the event loop, the first was answered after "
        "87 s, `/livez` with it, with 4.3 GB; the second after 21 s with 1.8 GB.",
        "",
        "| body | answer | after s | slowest `/livez`, s | memory before, MB | at most, MB |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
        *(
            f"| {name} | {one['status']} | {one['seconds']:.2f} | {one['livez']:.2f} | "
            f"{one['before']:.0f} | {one['peak']:.0f} |"
            for name, one in found.items()
        ),
        "",
        "The machine meanwhile: "
        + ", ".join(f"{what} {value:g}" for what, value in machine.figures().items())
        + ".",
    ]
    text = "\n".join(lines) + "\n"
    (chosen.results / "service-large-bodies.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
