"""What people do on the pages, in a real Chromium."""

import json
import re

import httpx
import numpy as np
import pytest

import engine
from engine.data import nile
from engine.data.csv_files import read_csv
from engine.data.files import write_series
from engine.data.stamps import counts
from engine.diagnose import hide
from service.auth import digest_of
from service.cli.new import write as write_model
from service.columns import match
from tests.e2e.browser import Watched, eventually, ready, service
from tests.service.test_columns import CASES, text


def write(path, **columns):
    names = list(columns)
    rows = zip(*columns.values(), strict=True)
    lines = [",".join("" if v is None else str(v) for v in row) for row in rows]
    path.write_text("\n".join([",".join(names), *lines]))
    return path


@pytest.fixture
def flows(tmp_path):
    """The Nile flows in columns that no name gives away, two of them missing."""
    flow = nile().y[:, 0].tolist()
    flow[20] = flow[21] = None
    return write(tmp_path / "flows.csv", station=[3] * 100, Q=flow, T=list(range(100)))


def test_upload_map_run_watch_and_keep_the_report(visit, flows, tmp_path):
    page = visit("/")
    ready(page)
    page.select_option("#model", "local-level")
    page.set_input_files("#file", flows)
    page.wait_for_selector("#channels select")
    assert page.input_value('[id="column-y.flow"]') == ""  # three columns, none of the name
    page.select_option('[id="column-y.flow"]', "Q")
    page.wait_for_selector("#channels .u-wrap canvas")
    assert "2 missing" in page.inner_text("#channels")
    assert "missing" in page.inner_text("#channels .chart-legend")
    page.uncheck('tr[data-name="level"] input[type=checkbox]')
    page.fill('tr[data-name="q"] .value', "1000")
    page.click("#options summary")
    page.fill("#estimate-iterations", "30")
    page.fill("#estimate-particles", "20")
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("#status.successful")
    page.wait_for_selector("#results table")
    job = page.url.rpartition("/")[2]
    asked = httpx.get(f"{visit.address}/jobs/{job}/request").json()
    assert asked["series"][0]["y"][20:23] == [[None], [None], [nile().y[22, 0]]]
    assert asked["parameters"]["free"] == ["q", "r"]
    assert asked["parameters"]["start"]["q"] == 1000.0
    with page.expect_download() as kept:
        page.click("#report")
    kept.value.save_as(tmp_path / "report.html")
    shown = page.context.new_page()
    visit.listen(shown)
    shown.goto((tmp_path / "report.html").as_uri())
    assert "local-level" in shown.inner_text("body")
    assert shown.locator("svg").count() > 0


@pytest.fixture
def long(address):
    """Id of an estimation that computes far longer than the test watches it."""
    y = engine.simulate(engine.get_model("linear-2"), None, 1500, np.random.default_rng(5)).y
    request = {
        "kind": "estimate",
        "model": "linear-2",
        "series": [{"y": y.tolist()}],
        "options": {"method": "rbps-em", "particles": 500, "iterations": 10_000},
    }
    job = httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]
    yield job
    httpx.post(f"{address}/jobs/{job}/stop")


@pytest.mark.slow
def test_watch_a_job_and_stop_it(visit, long):
    page = visit(f"/jobs/{long}")
    page.wait_for_selector("#traces canvas")
    first = iteration(page)
    eventually(page, lambda: iteration(page) > first)  # the page was not loaded again
    assert "effective sample size" in page.inner_text("#facts").lower()
    assert page.locator("#traces canvas").count() >= 2  # the parameter and the log-likelihood
    page.on("dialog", lambda asked: asked.accept())
    page.click("#stop")
    page.wait_for_selector("#status.dismissed")
    assert re.search(
        r"was stopped by you (at iteration \d|before it began)", page.inner_text("#problem")
    )
    assert not page.is_visible("#stop")
    page.wait_for_selector("#reached td")  # the values that it had reached
    assert "theta" in page.inner_text("#reached")
    assert page.locator("#traces canvas").count() >= 2  # and their curves


@pytest.mark.slow
def test_held_parameters_have_no_curve_from_the_first_iteration_on(visit, address):
    """Their curve, once drawn, would stand still beside the others."""
    model = engine.get_model("oscillator")
    y = engine.simulate(model, None, 200, np.random.default_rng(5), u=np.ones(200), dt=0.05).y
    request = {
        "kind": "estimate",
        "model": "oscillator",
        "series": [{"y": y.tolist(), "u": [1.0] * 200, "dt": 0.05}],
        "parameters": {"start": {"omega": 5.0}, "free": ["omega"]},
        "options": {"method": "rbps-em", "particles": 500, "iterations": 10_000},
    }
    job = httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]

    def no_further_than_the_first(route):
        trace = route.fetch().json()
        n = sum(k <= 1 for k in trace["iteration"])
        theta = {name: values[:n] for name, values in trace["theta"].items()}
        rest = {key: trace[key][:n] for key in ("iteration", "log_likelihood", "ess", "seconds")}
        route.fulfill(json=rest | {"theta": theta})

    page = visit("/jobs")
    page.route("**/trace?*", no_further_than_the_first)
    page.goto(f"{address}/jobs/{job}")
    page.wait_for_selector("#traces canvas")
    titles = page.locator("#traces .chart-title").all_inner_texts()
    page.unroute_all(behavior="ignoreErrors")
    httpx.post(f"{address}/jobs/{job}/stop")
    assert "omega" in titles
    assert not set(titles) & {"zeta", "gain", "sigma_v", "sigma_y"}


def test_a_page_goes_on_after_answers_that_failed(visit, address):
    """A proxy's error, a hint to wait and an answer cut off end no page: it asks again."""
    request = {"kind": "smooth", "model": "local-level", "series": [{"y": nile().y.tolist()}]}
    job = httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]
    failing = [{"status": 502, "body": "<h1>"}, {"status": 429, "json": {}}, {"body": '{"jobID"'}]

    def fails_at_first(route):
        if failing and asks(route):
            route.fulfill(**failing.pop(0))
        else:
            route.continue_()

    page = visit("/jobs")
    page.route(f"**/jobs/{job}", fails_at_first)
    page.goto(f"{address}/jobs/{job}")
    page.wait_for_selector("text=The service's answer was cut off.")
    page.wait_for_selector("#status.successful")
    page.wait_for_selector("#results canvas")
    assert not failing
    assert not page.is_visible("#problem")
    for status in ("502", "429"):
        visit.expect(f"status of {status}")


def asks(route):
    """Whether a page asks for data, in contrast to a page itself."""
    return route.request.resource_type == "fetch"


@pytest.mark.slow
def test_a_stopped_job_goes_on_where_it_was(visit, address, long):
    page = visit(f"/jobs/{long}")
    page.wait_for_selector("#traces canvas")
    eventually(page, lambda: iteration(page) > 1)
    assert not page.is_visible("#resume")
    page.on("dialog", lambda asked: asked.accept())
    page.click("#stop")
    page.wait_for_selector("#status.dismissed")
    at = httpx.get(f"{address}/jobs/{long}").json()["iteration"]
    page.click("#resume")
    page.wait_for_selector("#status.running")
    assert not page.is_visible("#reached")
    eventually(page, lambda: page.is_visible("#stop") and iteration(page) > at)
    assert not page.is_visible("#resume")
    trace = httpx.get(f"{address}/jobs/{long}/trace").json()["iteration"]
    assert trace == list(range(len(trace)))  # what it had was neither lost nor computed again
    assert not page.is_visible("#problem")
    httpx.post(f"{address}/jobs/{long}/stop")
    page.wait_for_selector("#resume:visible")  # also where somebody else has stopped it
    httpx.delete(f"{address}/jobs/{long}")  # its data, without which nothing can go on
    page.reload()
    page.wait_for_selector("#status.dismissed")
    assert not page.is_visible("#resume")


@pytest.mark.slow
def test_a_diagnosis_shows_what_it_knows_while_it_goes_on_and_keeps_it(visit, address):
    """The simulation of the fitted model first, then what a first look suspects; Stop leaves both."""
    servo, rng = engine.get_model("servo"), np.random.default_rng(2)
    u = np.repeat(np.random.default_rng(1).uniform(-8, 8, 24), 25)
    hidden = hide(servo, ["drag:velocity"], {"drag_velocity": 0.6}, 600, rng, u=u, dt=0.02)
    series = {"y": hidden.series.y.tolist(), "u": hidden.series.u.tolist(), "dt": 0.02}
    free = ["M", "Fv", "Fc", "offset", "sigma_v", "sigma_load", "sigma_y"]
    request = {
        "kind": "diagnose",
        "model": "servo",
        "series": [series],
        "parameters": {"free": free},
    }
    job = httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]
    page = visit(f"/jobs/{job}")
    page.wait_for_selector("#results #wrong table", timeout=300_000)
    assert page.is_visible("#status.running")
    assert "Free-run simulation of y: wrong by" in page.inner_text("#results #wrong")
    page.wait_for_selector("#results .figure.live canvas")
    page.wait_for_selector(
        "#results #screen table", timeout=300_000
    )  # without loading the page again
    assert page.is_visible("#status.running")
    page.on("dialog", lambda asked: asked.accept())
    page.click("#stop")
    page.wait_for_selector("#status.dismissed")
    page.wait_for_selector("#results #screen table")
    page.reload()
    page.wait_for_selector("#results #screen table")
    assert "Free-run simulation of y: wrong by" in page.inner_text("#results #wrong")
    assert page.is_visible("#resume")
    assert not page.is_visible("#next")
    httpx.post(f"{address}/jobs/{job}/stop")


def iteration(page):
    return int(re.search(r"iteration\s+(\d+)", page.inner_text("#facts"), re.IGNORECASE)[1])


@pytest.mark.slow
def test_diagnose_and_go_on_with_the_extension(visit):
    page = visit("/")
    ready(page)
    page.click("#example")
    page.wait_for_selector("#channels .u-wrap canvas")
    assert page.input_value("#time") == "year"
    assert page.input_value("#time-unit") == "year"
    assert "1871 to 1970 year" in page.inner_text("#time-facts")
    page.check('input[value="diagnose"]')
    page.click("#options summary")
    page.fill("#diagnose-effects", "step, pulse")
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("#status.successful")
    page.wait_for_selector("#extended:visible")
    assert "step" in page.inner_text("#results")
    assert "1899 year" in page.inner_text("#results")  # the dam at Aswan
    assert not re.search(r"\d s\b|\[s\]|Hz", page.inner_text("#results").split("seconds")[0][:2000])
    page.click("#extended")
    ready(page)
    assert "step:flow" in page.inner_text("#effects")
    assert page.is_checked('input[value="estimate"]')
    assert float(page.input_value('tr[data-name="step_flow"] .value')) == pytest.approx(
        -250, abs=40
    )
    assert page.is_checked('tr[data-name="step_flow"] input[type="checkbox"]')
    # held as in the diagnosis
    assert not page.is_checked('tr[data-name="step_flow_time"] input[type="checkbox"]')
    assert page.locator("#channels canvas").count() == 1  # the data need no second upload
    page.click("#options summary")
    page.fill("#estimate-iterations", "3")
    page.uncheck('[data-kind="estimate"] [data-option="standard_errors"]')
    page.click("#go")
    page.wait_for_url(lambda url: "/jobs/" in url)
    page.wait_for_selector("#status.successful")


@pytest.mark.slow
def test_a_diagnosis_leads_to_the_next_experiment(visit, address, tmp_path):
    rng = np.random.default_rng(0)
    model = engine.get_model("oscillator", effects=["coulomb:velocity"])
    u = np.repeat(rng.uniform(-1, 1, 20), 10)
    record = engine.simulate(
        model, model.theta({"coulomb_velocity": 1.0}), 200, rng, u=u, dt=0.05
    ).series
    asked = {
        "kind": "diagnose",
        "model": "oscillator",
        "series": [
            {
                "y": record.y.tolist(),
                "u": record.u.tolist(),
                "dt": 0.05,
                "hold": "foh",
                "time_unit": "min",
            }
        ],
        "options": {"effects": ["coulomb:velocity", "drag:velocity"], "seed": 0},
    }
    job = httpx.post(f"{address}/jobs", json=asked).headers["location"]
    page = visit(job.removeprefix(address))
    page.wait_for_selector("#status.successful")
    page.click("#next")
    assert page.locator("#design-causes input:checked").count() == 2
    form = page.inner_text("#design-form")
    assert "change per min" in form
    assert "stop bands, 1/min" in form
    assert "Time between samples, min" in form
    for what, value in (("low", "-1"), ("high", "1"), ("rate", "20"), ("stopbands", "0.5:1, 3:4")):
        page.fill(f'#design-inputs [data-what="{what}"]', value)
    page.fill('#design-inputs [data-what="forbidden"]', "0.1:x")
    page.fill('#design-states tr:first-child [data-what="high"]', "3")
    page.fill("#design-length", "60")
    page.click("#design-form button")
    page.wait_for_selector("#design-problem:visible")
    assert "forbidden" in page.inner_text("#design-problem")
    assert "drive: forbidden: '0.1:x'" in page.inner_text("#design-problem")
    page.fill('#design-inputs [data-what="forbidden"]', "-0.1:0.1")
    page.click("#design-form button")
    page.wait_for_url(lambda url: "/jobs/" in url and not url.endswith(job))
    page.wait_for_selector("#status.successful")
    assert "right name" in page.inner_text("#results")
    design = httpx.get(f"{page.url}/results").json()["design"]
    bounds = design["bounds"]
    assert bounds["inputs"]["drive"] == {
        "low": -1.0,
        "high": 1.0,
        "rate": 20.0,
        "forbidden": [[-0.1, 0.1]],
        "start": None,
        "stopbands": [[0.5, 1.0], [3.0, 4.0]],
    }
    assert bounds["states"] == {"position": [None, 3.0]}
    assert bounds["dt"] == pytest.approx(0.05)
    assert bounds["hold"] == "foh"
    assert design["time_unit"] == bounds["time_unit"] == "min"
    assert "0.05 min" in page.inner_text("#results")
    with page.expect_download() as saved:
        page.click("#input-file")
    saved.value.save_as(tmp_path / "input.csv")
    assert (tmp_path / "input.csv").read_text().startswith("t [min],drive\n")
    assert engine.Series.read(tmp_path / "input.csv", y=["drive"]).time_unit == "min"
    diagnosed = httpx.get(f"{job}/results" if "://" in job else f"{address}{job}/results").json()
    assert bounds["substeps"] == diagnosed["diagnosis"]["extension"]["model"]["setting"]["substeps"]


@pytest.mark.slow
def test_a_column_that_the_model_does_not_use_is_asked_about(visit, tmp_path):
    rng = np.random.default_rng(0)
    noise, rain = rng.standard_normal((2, 80))
    level = 1100 + np.cumsum(40 * noise + 150 * np.append(0.0, rain[:-1]))
    flow = level + 30 * rng.standard_normal(80)
    page = visit("/?model=local-level")
    ready(page)
    page.set_input_files("#file", write(tmp_path / "wet.csv", flow=flow, rain=rain))
    page.wait_for_selector("#channels .u-wrap canvas")
    page.check('#extra-columns label:has-text("rain") input')
    page.check('input[value="diagnose"]')
    page.click("#options summary")
    page.fill("#diagnose-effects", "extra-input, bias")
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("#status.successful")
    page.wait_for_selector("#extended:visible")
    assert "extra-input:rain->level" in page.inner_text("#results")
    page.click("#extended")
    ready(page)
    assert "80 values" in page.inner_text('[data-facts="u.rain"]')  # an input of the model now
    assert page.is_hidden("#extra")
    page.click("#options summary")
    page.fill("#estimate-iterations", "3")
    page.uncheck('[data-kind="estimate"] [data-option="standard_errors"]')
    page.click("#go")
    page.wait_for_url(lambda url: "/jobs/" in url)
    page.wait_for_selector("#status.successful")


def test_wrong_input_is_said_beside_its_field(visit, tmp_path):
    page = visit("/")
    ready(page)
    assert page.is_hidden("#parameters")
    page.click("#go")
    beside = page.locator('[data-field="model"] .field-error')
    assert beside.inner_text() == "choose a model"
    assert page.evaluate("document.activeElement.id") == "model"
    page.click("#example")
    page.wait_for_selector("#channels .u-wrap")
    page.fill('tr[data-name="r"] .value', "-4")
    page.click("#go")
    page.wait_for_selector('tr[data-name="r"] .field-error')
    assert "not within" in page.inner_text('tr[data-name="r"] .field-error')
    assert page.get_attribute('tr[data-name="r"] .value', "aria-invalid") == "true"
    visit.expect("422")
    commas = tmp_path / "commas.csv"
    commas.write_text("day;flow\n1;12,500\n2;13,500\n3;14\n")
    page.set_input_files("#file", commas)
    page.wait_for_selector("#data-facts .notice")
    assert "decimal comma" in page.inner_text("#data-facts")
    # The only usable column is not taken for the channel.
    assert page.input_value('[id="column-y.flow"]') == ""
    units = tmp_path / "units.csv"
    units.write_text("t,flow\n[ticks],[buckets]\n0,12\n1,13\n2,14\n")
    page.set_input_files("#file", units)
    page.wait_for_selector('#data-facts .notice:has-text("line of units")')
    assert page.locator("#data-facts .notice").count() == 1
    page.set_input_files("#file", write(tmp_path / "ms.csv", time_ms=[0, 20, 40], y=[1, 2, 3]))
    page.wait_for_selector('#data-facts:has-text("ms.csv")')
    page.select_option("#time", "time_ms")
    eventually(page, lambda: page.input_value("#time-unit") == "ms")
    assert "0 to 40 ms, step 20 ms" in page.inner_text("#time-facts")
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    page.set_input_files("#file", empty)
    page.wait_for_selector('[data-field~="file"] .field-error')
    assert "is empty" in page.inner_text('[data-field~="file"] .field-error')
    assert page.is_hidden("#data-card")  # nothing of the file before it is left
    visit.expect("422")


def test_dates_are_times_and_what_is_wrong_with_times_stays_in_sight(visit, tmp_path):
    page = visit("/?model=local-level")
    ready(page)
    stamps = [f"2024-05-01 00:{k // 6:02}:{k % 6}0" for k in range(30)]
    for name in ("time", "Zeitstempel"):
        dated = write(tmp_path / f"{name}.csv", **{name: stamps, "flow": list(range(30))})
        page.set_input_files("#file", dated)
        page.wait_for_selector(f'#data-facts:has-text("{name}.csv")')
        assert page.input_value("#time") == name
        assert "0 to 290 s, step 10 s" in page.inner_text("#time-facts")
        assert not page.locator("#data-facts .notice").count()
    page.fill("#time-unit", "min")
    page.press("#time-unit", "Tab")
    eventually(page, lambda: "step 0.16667 min" in page.inner_text("#time-facts"))
    page.set_input_files("#file", write(tmp_path / "back.csv", time=[0, 1, 0.5], flow=[1, 2, 3]))
    page.wait_for_selector('#data-facts:has-text("back.csv")')
    assert page.input_value("#time") == "time"
    assert "Column 'time': decreases at line 4 (0.5)" in page.inner_text("#time-facts")
    page.click("#go")
    page.wait_for_selector('[data-field~="t"] .field-error')
    long = [1711846800.0, 1711846800.1, 1711846800.2]
    page.set_input_files("#file", write(tmp_path / "long.csv", time=long, flow=[1, 2, 3]))
    page.wait_for_selector('#data-facts:has-text("long.csv")')
    assert "1711846800 to 1711846800.2 s, step 0.1 s" in page.inner_text("#time-facts")


def test_the_step_of_a_file_is_shown_in_the_unit_that_is_asked_for(visit, tmp_path):
    """A job converts it; the page went on to say that it is 20."""
    page = visit("/?model=local-level")
    ready(page)
    np.savez(tmp_path / "a.npz", y=np.arange(9.0), dt=20.0, time_unit="ms")
    page.set_input_files("#file", tmp_path / "a.npz")
    page.wait_for_selector('#data-facts:has-text("a.npz")')
    for unit, step in (("s", "0.02"), ("ms", "20")):
        page.fill("#time-unit", unit)
        page.press("#time-unit", "Tab")
        eventually(page, lambda step=step: page.get_attribute("#dt", "placeholder") == step)
        assert page.input_value("#time-unit") == unit


def test_no_step_is_sent_that_nobody_typed(visit, tmp_path):
    page = visit("/?model=local-level")
    ready(page)
    page.set_input_files("#file", write(tmp_path / "a.csv", station=[3, 3, 3], flow=[1, 2, 3]))
    page.wait_for_selector('#data-facts:has-text("a.csv")')
    assert "a step of 1 s is assumed" in page.inner_text("#time-facts")
    page.click("#as-request summary")
    eventually(page, lambda: '"series"' in page.inner_text("#request-text"))
    assert '"dt"' not in page.inner_text("#request-text")
    page.fill("#dt", "0.5")
    eventually(page, lambda: '"dt": 0.5' in page.inner_text("#request-text"))


def test_a_file_of_any_name_is_sent(visit):
    page = visit("/?model=local-level")
    ready(page)
    name = 'Gr\u00f6\u00dfe "1" #2 &%20.csv'
    rows = "t,flow\n" + "".join(f"{k},{k % 7}\n" for k in range(30))
    page.set_input_files("#file", {"name": name, "mimeType": "text/csv", "buffer": rows.encode()})
    page.wait_for_selector("#channels select")
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    job = f"{visit.address}/jobs/{page.url.rpartition('/')[2]}"
    assert httpx.get(f"{job}/request").json()["data"] == [name]
    httpx.post(f"{job}/stop")


def test_numbers_keep_their_digits(visit):
    page = visit("/")
    shown = page.evaluate(
        """async () => {
            const { number } = await import("/static/api.js");
            return [1234567, 0.00012345, 0.012345, 1e-5].map((x) => number(x));
        }"""
    )
    assert shown == ["1.2346e6", "1.2345e-4", "0.012345", "1e-5"]


def test_light_and_dark(visit):
    page = visit("/", color_scheme="dark")
    shade = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"

    def dark():
        return max(page.evaluate(shade)) < 60

    def light():
        return min(page.evaluate(shade)) > 200

    eventually(page, dark)
    page.click("#theme")
    eventually(page, light)
    page.goto(f"{visit.address}/jobs")
    eventually(page, light)  # remembered
    page.click("#theme")
    eventually(page, dark)
    page.emulate_media(color_scheme="light")
    eventually(page, light)
    page.emulate_media(color_scheme="dark")  # chosen was what the system said: followed again
    eventually(page, dark)


def tab_to(page, selector):
    for _ in range(80):
        if page.evaluate("s => document.activeElement?.matches(s) ?? false", selector):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"the tab key does not reach {selector}")


def said(page):
    """What is read aloud of the element that has the focus."""
    return page.evaluate("document.activeElement.ariaLabel ?? ''")


def test_keyboard_only(visit, flows):
    page = visit("/")
    # From now on, not from just before the key: it would be a race which of the two the page gets first.
    choosers = []
    page.on("filechooser", lambda chooser: choosers.append(chooser))
    ready(page)
    page.keyboard.press("Tab")
    eventually(page, lambda: page.evaluate("document.activeElement.className") == "skip")
    tab_to(page, "#model")
    for _ in range(20):  # letters typed with pauses between them would each choose anew
        if page.input_value("#model") == "local-level":
            break
        page.keyboard.press("ArrowDown")
    tab_to(page, "#file")
    page.keyboard.press("Enter")
    eventually(page, lambda: choosers)
    choosers[0].set_files(flows)
    page.wait_for_selector('[id="column-y.flow"]')
    tab_to(page, '[id="column-y.flow"]')
    page.keyboard.type("Q")
    page.wait_for_selector("#channels .u-wrap canvas")
    tab_to(page, "#channels .chart-frame")
    eventually(page, lambda: "2 missing" in said(page))
    page.keyboard.press("Home")
    eventually(page, lambda: "Q 1120" in said(page))
    page.keyboard.press("ArrowRight")
    eventually(page, lambda: "Q 1160" in said(page))
    tab_to(page, 'input[name="kind"]')
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    eventually(page, lambda: page.is_checked('input[value="smooth"]'))
    tab_to(page, "#go")
    page.keyboard.press("Enter")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("#status.successful")


def test_list_of_jobs(visit, long):
    short = {"kind": "smooth", "model": "local-level", "series": [{"y": nile().y.tolist()}]}
    httpx.post(f"{visit.address}/jobs", json=short).raise_for_status()
    page = visit("/jobs")
    page.wait_for_selector(f'[data-job="{long}"]')
    page.select_option("#kind", "smooth")
    page.wait_for_selector(f'[data-job="{long}"]', state="detached")
    assert "kind=smooth" in page.url
    page.click("#clear")
    page.click(f'[data-job="{long}"] .actions button >> text=Stop')
    page.click("#sure-yes")
    page.wait_for_selector(f'[data-job="{long}"] .badge.dismissed')
    page.locator("#jobs tr", has_text="smooth").get_by_text("Repeat").first.click()
    ready(page)
    assert page.is_checked('input[value="smooth"]')
    assert "100 samples" in page.inner_text("#data-facts")


def submit(address, name, **more):
    """A fit of the simulation to a quarter of the Nile flows that is done; its id."""
    request = {
        "kind": "estimate", "model": "local-level", "series": [{"y": nile().y[:40].tolist()}],
        "test": {"y": nile().y[40:].tolist()}, "options": {"method": "rts-em", "iterations": 3},
        "name": name,
    } | more  # fmt: skip
    return httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]


@pytest.mark.slow
def test_jobs_are_named_sorted_and_compared(visit):
    ids = [
        submit(visit.address, name, tags=["flows", tag])
        for name, tag in (("zeta", "one"), ("alpha", "two"), ("mu", "two"))
    ]
    page = visit("/jobs?tag=flows")
    for id_ in ids:
        page.wait_for_selector(f'[data-job="{id_}"] input[type="checkbox"]')

    def shown():
        return page.locator("#jobs td.name a").all_inner_texts()

    assert shown() == ["mu", "alpha", "zeta"]
    page.click('th[data-sort="name"] button')
    eventually(page, lambda: shown() == ["alpha", "mu", "zeta"])
    assert page.get_attribute('th[data-sort="name"]', "aria-sort") == "ascending"
    page.click('th[data-sort="name"] button')
    eventually(page, lambda: shown() == ["zeta", "mu", "alpha"])
    assert "sort=-name" in page.url
    row = page.locator(f'[data-job="{ids[0]}"]')
    assert "log-likelihood" in row.inner_text()
    assert "held-out error of flow" in row.inner_text()
    row.get_by_text("Name", exact=True).click()
    page.fill("#label-name", "omega")
    page.fill("#label-tags", "flows, a, ,b")
    page.click("#labels button.primary")
    eventually(page, lambda: shown() == ["omega", "mu", "alpha"])
    row.get_by_text("b", exact=True).click()  # a tag filters
    eventually(page, lambda: shown() == ["omega"])
    page.fill("#tag", "two")
    page.press("#tag", "Enter")
    eventually(page, lambda: shown() == ["mu", "alpha"])

    assert page.get_attribute("#compare", "aria-disabled") == "true"
    for id_ in ids[1:]:
        page.check(f'[data-job="{id_}"] input')
    page.click("#compare")
    page.wait_for_selector("#results .u-wrap canvas")
    assert page.inner_text("#title") == "alpha and mu"
    text = page.inner_text("#results")
    for words in ("log-likelihood", "held-out error of flow", "standard errors"):
        assert words in text, words
    assert page.locator("#results .u-wrap canvas").count() >= 2
    legend = page.locator("#results .chart-legend").first.inner_text()
    assert all(name in legend for name in ("alpha", "mu", "measured"))
    with page.expect_download() as caught:
        page.click("#report")
    assert "<svg" in caught.value.path().read_text()
    page.click("#swap")
    page.wait_for_selector("#results .u-wrap canvas")
    assert page.inner_text("#title") == "mu and alpha"
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") == 0
    page.goto(f"{visit.address}/jobs?tag=flows")
    page.wait_for_selector(f'[data-job="{ids[0]}"] input[type="checkbox"]')
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") == 0


def test_a_job_is_named_where_it_is_made(visit, flows):
    page = visit("/?model=local-level")
    ready(page)
    page.set_input_files("#file", flows)
    page.wait_for_selector("#data-card:visible")
    page.select_option("select[id='column-y.flow']", "Q")
    page.fill("#job-name", "Aswan")
    page.fill("#job-tags", "dam, river")
    page.check('input[value="smooth"]')
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("#status.successful")
    assert page.inner_text("#title") == "Aswan"
    assert page.locator("#tags li").all_inner_texts() == ["dam", "river"]
    assert "flows.csv" in page.inner_text("#when")
    page.click("#repeat")
    ready(page)
    assert page.input_value("#job-name") == "Aswan"
    assert page.input_value("#job-tags") == "dam, river"
    assert "flows.csv" in page.inner_text("#checks")


@pytest.mark.slow
def test_keys(visit, tmp_path):
    keys = tmp_path / "keys"
    keys.write_text(
        "".join(f"{name} {digest_of(f'key of {name}')}\n" for name in ("anna", "boris"))
    )
    request = {"kind": "simulate", "model": "linear-2", "options": {"samples": 9}}
    with service(tmp_path, keys_file=keys) as address:
        job = httpx.post(
            f"{address}/jobs", json=request, headers={"X-API-Key": "key of anna"}
        ).json()
        page = visit("/jobs", address)
        page.fill("#key-input", "wrong")
        page.click("#key-dialog .primary")
        page.wait_for_selector("#key-error:not(:empty)")
        visit.expect("401")
        page.fill("#key-input", "key of anna")
        page.click("#key-dialog .primary")
        page.wait_for_selector(f'[data-job="{job["jobID"]}"]')
        page.reload()  # the key is asked for once
        page.wait_for_selector(f'[data-job="{job["jobID"]}"]')
        other = visit(f"/jobs/{job['jobID']}", address)
        other.fill("#key-input", "key of boris")
        other.click("#key-dialog .primary")
        other.wait_for_selector("#problem:visible")
        assert "there is no job" in other.inner_text("#problem")
        visit.expect("404")
        for context in visit.contexts:
            context.close()
        visit.contexts.clear()


@pytest.mark.slow
def test_100_000_samples(visit, tmp_path):
    model = engine.get_model("linear-2")
    y = engine.simulate(model, None, 100_000, np.random.default_rng(0)).y[:, 0]
    y /= np.abs(y).max()
    y[77_777] = 2.5
    page = visit("/?model=linear-2")
    ready(page)
    page.set_input_files("#file", write(tmp_path / "long.csv", y=y.round(4).tolist()))
    page.wait_for_selector("#channels .u-wrap canvas")
    assert "100,000 samples" in page.inner_text("#data-facts")
    page.focus("#channels .chart-frame")
    assert "and 2.5;" in page.evaluate("document.activeElement.ariaLabel")  # thinned, not lost
    spoken = set()
    for key in ("+", "+", "ArrowRight", "ArrowRight", "0", "End"):
        page.keyboard.press(key)
        spoken.add(page.evaluate("document.activeElement.ariaLabel"))
    assert len(spoken) == 4  # the cursor moves by what is drawn, so that steps can be seen


def test_columns_are_matched_as_the_service_does(visit):
    """The page has the rules of ``service.columns`` once more; here they meet the same files."""
    page = visit("/")
    ready(page)
    words = ["flow", "Flow", "flow_in", "flow_V", "y", "y1", "u_flow", "level", "t", "time [h]"]
    words += ["t_min", "year", "rain"]
    rng = np.random.default_rng(1)
    cases = [CASES[name][:3] for name in CASES]
    for _ in range(200):
        columns = ",".join(rng.permutation(words)[: rng.integers(1, 6)])
        names = [str(one) for one in rng.permutation(["flow", "level", "rate"])]
        cut = rng.integers(0, 4)
        cases.append((columns, " ".join(names[:cut]), " ".join(names[cut : rng.integers(cut, 4)])))
    asked, expected = [], []
    for columns, outputs, inputs in cases:
        table = read_csv(text(columns).encode(), "a.csv")
        found = match(table, outputs.split(), inputs.split(), {})
        members = dict.fromkeys(outputs.split(), "y") | dict.fromkeys(inputs.split(), "u")
        expected.append({f"{members[one]}.{one}": column for one, column in found.items()})
        channels = [{"member": member, "name": one} for one, member in members.items()]
        counting = [name for name in table.columns if counts(table.column(name))]
        asked.append([channels, list(table.columns), counting])
    found = page.evaluate(
        """async (asked) => {
            const { match } = await import("/static/start/match.js");
            return asked.map(([channels, columns, counting]) =>
                Object.fromEntries(match(channels, columns, new Set(counting))));
        }""",
        asked,
    )
    assert found == expected


@pytest.mark.slow
def test_a_model_of_ones_own_with_its_equations_and_what_its_check_says(chrome, tmp_path):
    models = tmp_path / "models"
    models.mkdir()
    write_model(models / "pendulum.py", as_json=True)
    (models / "broken.py").write_text("import nowhere_at_all\n")
    with service(tmp_path, models=models) as address:
        watched = Watched(chrome, address)
        page = watched("/?model=pendulum")
        ready(page)
        assert page.input_value("#model") == "pendulum"
        assert "(your own)" in page.inner_text("#model option:checked")
        assert "sin" in page.inner_text("#model-equations")
        assert page.input_value('tr[data-name="w2"] .value') == "30"
        assert "gravity over length" in page.inner_text("#parameters")
        page.click("#model-check summary")
        assert "Shapes, values and covariances are right" in page.inner_text("#model-check")
        assert "broken.py cannot be used" in page.inner_text("#broken")
        watched.check()


def test_times_are_converted_to_what_the_model_counts(chrome, tmp_path):
    """Of a model that counts minutes nothing was said beside a record in seconds."""
    models = tmp_path / "models"
    models.mkdir()
    write_model(models / "pendulum.py", as_json=True)
    text = (models / "pendulum.py").read_text()
    for unit in ("rad/s", "(rad/s)^2/s", "1/s^2", "1/s"):
        text = text.replace(f'"{unit}"', f'"{unit.replace("/s", "/min")}"')
    (models / "pendulum.py").write_text(text)
    logged = tmp_path / "log.csv"
    logged.write_text("t [ms],y,torque\n" + "".join(f"{1500 * k},{k % 3},1\n" for k in range(40)))
    with service(tmp_path, models=models) as address:
        watched = Watched(chrome, address)
        page = watched("/?model=pendulum")
        ready(page)
        page.set_input_files("#file", logged)
        page.wait_for_selector("#time-facts.field-error")
        for clock in ("s", "ms"):
            page.fill("#time-unit", clock)
            page.press("#time-unit", "Tab")
            eventually(
                page, lambda clock=clock: f"Times are in {clock}," in page.inner_text("#time-facts")
            )
            assert "Else write min as their unit" in page.inner_text("#time-facts")
        page.fill("#time-unit", "min")
        page.press("#time-unit", "Tab")
        eventually(page, lambda: "0 to 0.975 min, step 0.025 min" in page.inner_text("#time-facts"))
        watched.check()


@pytest.mark.slow
def test_the_simulation_is_fitted_first(visit, tmp_path):
    model = engine.get_model("oscillator")
    u = np.repeat(np.random.default_rng(0).uniform(-2, 2, 20), 10)
    run = engine.simulate(model, {"omega": 7.0}, 200, np.random.default_rng(1), u=u, dt=0.05)
    write_series(run.series, tmp_path / "run.csv")
    page = visit("/?model=oscillator")
    ready(page)
    page.set_input_files("#file", tmp_path / "run.csv")
    page.wait_for_selector("#channels .u-wrap canvas")
    page.fill("#time-unit", "min")  # the model counts seconds
    page.press("#time-unit", "Tab")
    page.wait_for_selector("#time-facts.field-error")
    assert "Times are in min, and the model has" in page.inner_text("#time-facts")
    page.fill("#time-unit", "s")
    page.press("#time-unit", "Tab")
    page.wait_for_selector("#time-facts.hint")
    page.click("#options summary")
    assert page.is_visible("#estimate-iterations")
    page.select_option("#estimate-method", "simulation")
    for name in ("iterations", "particles", "starts", "bootstrap", "first"):
        assert page.is_hidden(f"#estimate-{name}"), name
    page.fill("#estimate-substeps", "2")
    page.click("#as-request summary")
    assert '"substeps": 2' in page.inner_text("#request-text")
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("#status.successful")
    page.wait_for_selector("#results table")
    shown = page.inner_text("#results")
    assert "no influence" in shown  # of the noise
    assert "errors of the run that last" in shown
    page.wait_for_selector("#results .u-wrap canvas")
    found = httpx.get(page.url + "/results").json()
    assert found["estimate"]["omega"]["value"] == pytest.approx(7.0, rel=0.05)
    page.click("#repeat")
    ready(page)
    assert page.input_value("#estimate-method") == "simulation"


@pytest.mark.slow
def test_a_job_goes_on_with_more_iterations(visit, address):
    y = engine.simulate(engine.get_model("linear-2"), None, 40, np.random.default_rng(5)).y
    request = {
        "kind": "estimate",
        "model": "linear-2",
        "series": [{"y": y.tolist()}],
        "options": {
            "method": "rbps-em",
            "particles": 10,
            "iterations": 1,
            "standard_errors": False,
        },
    }
    job = httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]
    page = visit(f"/jobs/{job}")
    page.wait_for_selector("#more:visible")
    assert page.input_value("#more-value") == "2"
    page.fill("#more-value", "3")
    page.click("#resume")
    eventually(page, lambda: httpx.get(f"{address}/jobs/{job}").json()["iteration"] == 3)
    request |= {"run_seconds": 0.3}
    request["options"] |= {"iterations": 10_000, "particles": 300}
    job = httpx.post(f"{address}/jobs", json=request).raise_for_status().json()["jobID"]
    page = visit(f"/jobs/{job}")
    page.wait_for_selector("#status.failed")
    page.wait_for_selector("#more:visible")
    visit.expect("422")  # its results so far, of which there are none
    page.fill("#more-value", "0.7")
    page.click("#resume")
    eventually(page, lambda: "0.7 s" in httpx.get(f"{address}/jobs/{job}").json()["message"])


def test_a_request_names_only_parameters_that_were_changed(visit, address):
    page = visit("/?model=oscillator")
    ready(page)
    page.check('input[value="diagnose"]')
    page.click("#as-request summary")
    page.wait_for_selector("#request-text:not(:empty)")

    def asked():
        return json.loads(page.inner_text("#request-text").partition("\n")[2])["parameters"]

    assert asked() == {}
    page.fill('tr[data-name="omega"] .value', "2.5")
    assert asked() == {"start": {"omega": 2.5}}
    page.uncheck('tr[data-name="omega"] input[type=checkbox]')
    assert "omega" not in asked()["free"]
    page.check('input[value="simulate"]')
    assert asked() == {"values": {"omega": 2.5}}
    omega = engine.get_model("oscillator").theta()["omega"]
    job = {"kind": "diagnose", "model": "oscillator", "parameters": {"start": {"omega": omega}}}
    y = np.sin(0.1 * np.arange(60.0))
    job["series"] = [{"y": y.tolist(), "u": y.tolist(), "dt": 0.1}]
    sent = httpx.post(f"{address}/jobs", json=job).raise_for_status().json()["jobID"]
    httpx.post(f"{address}/jobs/{sent}/stop")
    page = visit(f"/?job={sent}")
    ready(page)
    page.click("#as-request summary")
    page.wait_for_selector("#request-text:not(:empty)")
    assert asked() == {"start": {"omega": omega}}  # as it was given, so as it is repeated


def test_the_guide_is_there_without_a_network(visit):
    page = visit("/")
    ready(page)
    page.click('nav a[href="/guide/start"]')
    page.wait_for_selector("article h1")
    assert page.inner_text("article h1") == "Fifteen minutes"
    names = page.locator(".guide nav a").evaluate_all("all => all.map((one) => one.pathname)")
    assert len(names) > 10
    for name in names:
        page.goto(visit.address + name)
        assert page.inner_text("article h1")
    page.goto(visit.address + "/guide/effects")
    assert page.locator(".catalogue svg").count() > 10
    page.set_viewport_size({"width": 360, "height": 700})
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_one_file_with_the_records_of_several_subjects(visit, tmp_path):
    """Times that fall back are told, with the column that may tell records apart, which is then chosen."""
    flow = nile().y[:60, 0].tolist()
    path = write(
        tmp_path / "all.csv",
        Subject=[f"s{k // 20}" for k in range(60)],
        t=3 * [*range(20)],
        flow=flow,
    )
    page = visit("/")
    ready(page)
    page.select_option("#model", "local-level")
    page.set_input_files("#file", path)
    page.wait_for_selector("#time-facts.field-error")
    assert "If the column 'Subject' names the records" in page.inner_text("#time-facts")
    page.select_option("#by", "Subject")
    page.wait_for_selector("#time-facts.hint")
    assert "0 to 19 s" in page.inner_text("#time-facts")
    page.click("#options summary")
    page.fill("#estimate-iterations", "2")
    page.fill("#estimate-particles", "10")
    page.click("#go")
    page.wait_for_url("**/jobs/*")
    job = page.url.rpartition("/")[2]
    asked = httpx.get(f"{visit.address}/jobs/{job}/request").json()
    assert [len(one["t"]) for one in asked["series"]] == [20, 20, 20]
