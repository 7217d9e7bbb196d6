"""Figures of results and their notebook display."""

import subprocess
import sys

import numpy as np
import pytest

import engine
from engine.data import nile
from engine.presentation import plots
from engine.simulation.free_run import Bands


@pytest.fixture(scope="module")
def level():
    return engine.get_model("local-level")


@pytest.fixture(scope="module")
def estimate(level):
    return engine.rbps_em(level, nile(), free=["q", "r"], n_particles=10, n_iterations=5, seed=1)


@pytest.fixture(scope="module")
def smoothed(level):
    rng = np.random.default_rng(0)
    return engine.rb_ffbsi(engine.rbpf(level, None, nile(), 50, rng), 50, rng, joint=True)


def curves(figure):
    """{label of the y axis: the data of its longest curve}."""
    out = {}
    for panel in figure.axes:
        longest = max(panel.get_lines(), key=lambda one: len(one.get_ydata()), default=None)
        if longest is not None:
            out[panel.get_ylabel()] = np.asarray(longest.get_ydata(), dtype=float)
    return out


@pytest.mark.long
def test_convergence_shows_every_free_parameter(estimate):
    drawn = curves(estimate.plot()["convergence"])
    assert set(drawn) == {
        "q [10¹⁶ m⁶]", "r [10¹⁶ m⁶]", "log-likelihood", "effective sample size",
    }  # fmt: skip
    assert np.array_equal(drawn["r [10¹⁶ m⁶]"], estimate.trace[:, 1])
    assert np.array_equal(drawn["log-likelihood"][1:], estimate.log_likelihood)


@pytest.mark.long
def test_convergence_with_intervals(estimate):
    intervals = np.array([[1000.0, 2000.0], [np.nan, np.nan], [1.0, 2.0]])
    panels = estimate.plot(intervals)["convergence"].axes
    box = panels[0].collections[0].get_paths()[0].get_extents()
    assert np.allclose([box.y0, box.y1], [1000.0, 2000.0])
    assert not panels[1].collections  # NaN: no interval is known


def test_smoothed_states_and_residuals(smoothed):
    figures = smoothed.plot()
    assert np.allclose(curves(figures["states"])["level [10⁸ m³]"], smoothed.mean()[:, 0])
    # y = z + e, so the outputs but for e are the level itself
    assert np.allclose(smoothed.outputs(), smoothed.mean())
    residuals = curves(figures["residuals"])["measured - smoothed"]
    assert np.allclose(residuals, (nile().y - smoothed.mean())[:, 0])


def test_outputs_of_a_model_with_nonlinear_states():
    model = engine.get_model("mixed-4")
    series = engine.simulate(model, None, 40, np.random.default_rng(1)).series
    filtered = engine.rbpf(model, None, series, 40, np.random.default_rng(2))
    smoothed = engine.rb_ffbsi(filtered, 30, np.random.default_rng(3))
    record = model.record(model.theta())
    expected = []
    for t in range(40):
        h, C, _ = model.observation(smoothed.a[t], np.zeros(0), float(t), record)
        expected.append((h + smoothed.z[t] @ C.T).mean(axis=0))
    assert np.allclose(smoothed.outputs(), expected)
    assert set(smoothed.plot()) == {"states", "residuals"}


def test_runs_and_smoothers(level):
    run = engine.free_run(level, None, nile(), bands=Bands(draws=20))
    drawn = curves(run.plot()["outputs"])
    assert np.allclose(drawn["measured - free run"], run.residuals[:, 0])
    drawn = engine.simulate(level, None, 30, np.random.default_rng(0)).plot()
    assert set(drawn) == {"outputs", "states"}
    exact = engine.kalman_smoother(level, None, nile())
    assert np.allclose(curves(exact.plot(nile())["states"])["level [10⁸ m³]"], exact.x[:, 0])
    fit = engine.fit_simulation(level, [nile(), nile()], n_starts=2)
    assert set(fit.plot()) == {"outputs-1", "states-1", "outputs-2", "states-2"}


@pytest.mark.long
def test_save_writes_both_formats(estimate, tmp_path):
    written = estimate.plot().save(tmp_path / "figures")
    assert [path.name for path in written] == ["convergence.svg", "convergence.png"]
    assert written[0].read_text().lstrip().startswith("<?xml")
    assert written[1].read_bytes().startswith(b"\x89PNG")
    with pytest.raises(engine.OptionError, match="format 'gif'"):
        estimate.plot().save(tmp_path, ["gif"])


@pytest.mark.long
def test_long_curves_are_pixels_within_an_svg(tmp_path):
    n = 4 * plots.MANY_POINTS
    t, x = np.arange(n) * 1.0, np.random.default_rng(0).standard_normal((n, 1))
    figures = plots.Figures(states=plots.states(t, {"x": ""}, x, np.ones((n, 1))))
    (path,) = figures.save(tmp_path, ["svg"])
    assert path.stat().st_size < 1_000_000


@pytest.mark.long
def test_without_matplotlib_the_extra_is_named(tmp_path):
    code = (
        "import sys; sys.modules['matplotlib'] = None\n"
        "import engine\nfrom engine.presentation import plots\n"
        "try: plots.axes(1, 1, (1, 1))\n"
        "except engine.OptionError as error: print(error)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "figures need matplotlib: pip install 'rbps[plot]'\n"


@pytest.mark.long
def test_what_loads_slowly_is_not_imported_with_the_engine():
    code = "import sys, engine; print({'matplotlib', 'scipy.stats'} & {*sys.modules})"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "set()\n"
