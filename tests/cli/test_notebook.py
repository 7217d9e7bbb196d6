"""What a notebook shows, and a model written in one of its cells."""

import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

import engine
from engine.data import nile
from tests.engine.clear_step import clear_flows

# A cell as a user writes it; IPython runs it by exec in the namespace of __main__.
CELL = """
import numpy as np, engine

def dynamics(a, u, t, dt, theta):
    return [a[:, 0] - dt * theta.c * a[:, 0] * abs(a[:, 0]) + dt * u[0]], np.zeros((1, 0)), [[1e-4]]

def measurement(a, u, t, theta):
    return [a[:, 0]], np.zeros((1, 0)), [[theta.r]]

def initial(theta):
    return engine.Gaussian([0.0], [[0.1]]), [], np.zeros((0, 0))

mine = engine.MixedModel(
    name="mine", dynamics=dynamics, measurement=measurement, initial=initial,
    nonlinear={"speed": "m/s"}, inputs={"thrust": "m/s^2"}, outputs={"reading": "m/s"},
    parameters=[engine.Parameter("c", 0.1, "1/m", (0, 5)),
                engine.Parameter("r", 0.01, "(m/s)^2", (1e-6, 1))])
"""
DATA = """
u = 2 + np.sin(0.3 * np.arange(120))
series = engine.simulate(mine, {"c": 0.3}, 120, np.random.default_rng(0), u=u, dt=0.1).series
"""
DIAGNOSE = """
diagnosis = engine.diagnose(mine, series, effects=["bias", "cubic"], seed=1)
"""
ESTIMATE = """
found = engine.rbps_em(mine, series, n_particles=20, n_iterations=5, seed=1, method="em")
"""
FORKED = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

def estimate(seed):
    return engine.rbps_em(mine, series, n_particles=20, n_iterations=5, seed=seed, method="em")

with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
    print(pool.submit(estimate, 1).result().theta["c"], found.theta["c"])
"""
SENT = """
import subprocess, sys, cloudpickle
worker = "import cloudpickle, sys; print(cloudpickle.load(sys.stdin.buffer)().theta['c'])"
def estimate():
    return engine.rbps_em(mine, series, n_particles=20, n_iterations=5, seed=1, method="em")
sent = subprocess.run([sys.executable, "-c", worker], input=cloudpickle.dumps(estimate),
                      capture_output=True, check=True)
print(sent.stdout.decode().strip(), found.theta["c"])
"""


class Checker(HTMLParser):
    """Tags opened and closed in order; the text between them."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.text = [], set(), []
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag != "img":
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def cell():
    import __main__

    namespace = vars(__main__)
    before = set(namespace)
    exec(compile(CELL, "<ipython-input-1>", "exec"), namespace)
    exec(compile(DATA + ESTIMATE + DIAGNOSE, "<ipython-input-2>", "exec"), namespace)
    yield namespace
    for name in set(namespace) - before:
        del namespace[name]


@pytest.mark.long
def test_a_model_in_a_cell_needs_no_registration(cell):
    assert cell["mine"].dynamics.__module__ == "__main__"
    assert "mine" not in engine.model_names()
    assert cell["found"].theta["c"] > 0.15
    assert cell["diagnosis"].model is cell["mine"]


@pytest.mark.slow
@pytest.mark.parametrize("how", [FORKED, SENT], ids=["forked", "sent as Dask does"])
def test_a_model_in_a_cell_works_in_workers(how):
    script = CELL + DATA + ESTIMATE + how
    code = f"exec(compile({script!r}, '<ipython-input-1>', 'exec'))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
    there, here = run.stdout.split()
    assert there == here


def test_displays_are_tables(cell):
    found, series, mine = cell["found"], cell["series"], cell["mine"]
    errors = engine.standard_errors(mine, found.theta, series, replicates=2)
    run = engine.free_run(mine, found.theta, series)
    rng = np.random.default_rng(0)
    smoothed = engine.rb_ffbsi(engine.rbpf(mine, None, series, 20, rng), 20, rng)
    fit = engine.fit_simulation(mine, series, n_starts=2)
    for shown, words in (
        (mine, ["mine", "speed", "thrust", "reading", "c", "1/m", "0.1"]),
        (series, ["120 samples, every 0.1 s, t = 0 ... 11.9 s", "reading", "thrust"]),
        (found, ["mine: 5 iterations", "c", "1/m"]),
        (errors, ["mine: standard errors", "c"]),
        (run, ["mine: free run over 120 samples", "reading"]),
        (smoothed, ["mine: 120 samples smoothed by 20 trajectories", "speed"]),
        (fit, ["c", "no influence"]),
        (
            engine.simulate(mine, None, 5, rng, u=np.ones(5)),
            ["5 samples, every 1 s, t = 0 ... 4 s"],
        ),
    ):
        page = Checker(shown._repr_html_())
        assert "table" in page.tags
        for word in words:
            assert word in page.text, (type(shown), word)


@pytest.mark.slow
def test_a_diagnosis_shows_its_verdict(cell):
    page = Checker(cell["diagnosis"]._repr_html_())
    assert page.text[0] == f"mine: {cell['diagnosis'].verdict.value}"
    found = engine.diagnose(
        engine.get_model("local-level"), clear_flows(), effects=["step"], seed=1
    )
    page = Checker(found._repr_html_())
    assert "step:flow" in page.text
    assert any("flow = ... + step_flow" in text for text in page.text)
    assert set(found.plot()) == set(found.figures())


def test_text_of_users_is_escaped(cell):
    from dataclasses import replace

    evil = replace(
        cell["mine"], name="<script>1</script>", description="a < b & c",
        equations=["x' = <img>"], parameters=[engine.Parameter("c", 0.1, "<b>", (0, 1), "<i>x</i>")],
        outputs={"<u>": "<s>"},
    )  # fmt: skip
    page = Checker(evil._repr_html_())
    assert not page.tags & {"script", "img", "i", "u", "s"}
    assert "<script>1</script>" in page.text
    assert "a < b & c" in page.text
    series = engine.Series([1.0, 2.0], y_names=["<script>"])
    assert "script" not in Checker(series._repr_html_()).tags


def test_series_with_gaps():
    page = Checker(engine.Series([[1.0, np.nan], [3.0, np.nan]], t=[0.0, 0.5])._repr_html_())
    assert page.text[6:] == ["y", "y1", "0", "1", "2", "3", "y", "y2", "2"]  # y2 has no values
    assert "irregularly" not in page.text[0]
    assert "irregularly" in Checker(engine.Series([1, 2, 3], t=[0, 1, 5])._repr_html_()).text[0]


@pytest.mark.long
def test_figures_show_themselves():
    level = engine.get_model("local-level")
    run = engine.free_run(level, None, nile())
    html = run.plot()._repr_html_()
    assert html.count('src="data:image/png;base64,') == 2
    assert Checker(html).tags == {"img"}
