"""Pictures of the pages for the documentation: ``python -m tests.e2e.screenshots [FOLDER [WIDTH]]``.

A WIDTH of 390 shows them as a phone does.
"""

import io
import sys
import tempfile
from pathlib import Path

import httpx
import numpy as np
from PIL import Image

import engine
from tests.e2e.browser import PATIENCE, browser, chromium, service

FOLDER = Path(__file__).parents[1] / "benchmarks" / "results" / "screenshots"
WIDTH = 1280  # px


def take(folder, width=WIDTH):
    """Write start, running, finished, diagnosis, jobs and compare.png into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as state,
        service(Path(state)) as address,
        browser() as chrome,
    ):
        page = chrome.new_page(viewport={"width": width, "height": 800}, color_scheme="light")
        page.set_default_timeout(PATIENCE)
        page.goto(f"{address}/")
        page.wait_for_selector("form[data-ready]")
        page.click("#example")
        page.wait_for_selector("#channels .u-wrap canvas")
        page.evaluate("document.activeElement.blur()")
        keep(page, folder / "start.png")
        page.check('input[value="diagnose"]')
        page.click("#go")
        page.wait_for_url("**/jobs/*")
        page.wait_for_selector("#status.successful")
        page.wait_for_selector("#results .u-wrap canvas")
        keep(page, folder / "diagnosis.png")
        first = submit(address, 200, "50 particles", particles=50)
        page.goto(f"{address}/jobs/{first}")
        page.wait_for_selector("#status.successful")
        page.wait_for_selector("#results .u-wrap canvas")
        keep(page, folder / "finished.png")
        second = submit(address, 200, "least squares", method="simulation")
        page.goto(f"{address}/jobs/{second}")
        page.wait_for_selector("#status.successful")
        page.goto(f"{address}/compare?a={second}&b={first}")
        page.wait_for_selector("#results .u-wrap canvas")
        keep(page, folder / "compare.png")
        long = submit(address, 2000, "long record", particles=100, method="rbps-em")
        page.goto(f"{address}/jobs/{long}")
        page.wait_for_selector("#traces canvas")
        page.wait_for_selector("#facts dd:text-matches('^1[2-9] of')")  # of iterations
        keep(page, folder / "running.png")
        page.goto(f"{address}/jobs")
        page.wait_for_selector(f'[data-job="{long}"]')
        keep(page, folder / "jobs.png")
        httpx.post(f"{address}/jobs/{long}/stop")


def submit(address, samples, name, **options):
    """Id of an estimation of the oscillator from simulated samples, with others held out."""
    series, other = (simulated(n) for n in (samples, 150))
    request = {
        "kind": "estimate",
        "model": "oscillator",
        "series": [series],
        "test": other,
        "name": name,
        "tags": ["test rig"],
        "data": [f"record-{samples}.csv"],
        "parameters": {
            "start": {"omega": 5.5, "sigma_y": 0.1},
            "free": ["omega", "zeta", "sigma_y"],
        },
        "options": options,
    }
    answer = httpx.post(f"{address}/jobs", json=request, timeout=60)
    return answer.raise_for_status().json()["jobID"]


def simulated(samples):
    """A record of the oscillator, driven by a new level each second."""
    rng = np.random.default_rng(samples)
    drive = np.repeat(rng.uniform(-1.0, 1.0, samples // 50 + 1), 50)[:samples]
    theta = {"sigma_y": 0.05}
    run = engine.simulate(engine.get_model("oscillator"), theta, samples, rng, u=drive, dt=0.02)
    return {"y": run.y.tolist(), "u": drive.tolist(), "dt": 0.02}


def keep(page, path):
    """The whole page, in 64 colours so that the file is small; by octree, which keeps rare ones."""
    page.evaluate("scrollTo(0, 0)")  # else the head of the page stands in its middle
    for name in ("beforeprint", "afterprint"):  # draws what is not yet in view
        page.evaluate("name => dispatchEvent(new Event(name))", name)
    picture = Image.open(io.BytesIO(page.screenshot(full_page=True, animations="disabled")))
    few = picture.convert("RGB").quantize(64, method=Image.Quantize.FASTOCTREE)
    few.save(path, optimize=True)


if __name__ == "__main__":
    if chromium() is None:
        sys.exit("screenshots need Chromium, which is not installed")
    where, wide = Path(sys.argv[1]) if sys.argv[1:] else FOLDER, int((*sys.argv[2:], WIDTH)[0])
    take(where, wide)
