"""What inputs do between their samples: the same for everything that steps a model."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine import Gaussian, MixedModel, Parameter, Series
from engine.data.files import csv_text, read_series, read_table, series_from, write_series
from engine.errors import OptionError, SeriesError
from engine.estimation.quasi_ml import quasi_ml
from engine.models.registry import get_model
from engine.statespace.general import as_nonlinear

HOLDS = ("zoh", "foh", "past")


def read_series_bytes(data, filename, **columns):
    """What an upload makes of a file."""
    return series_from(read_table(data, filename), **columns)


def bent(a, u, t, dt, theta):
    return [theta.p * np.sin(a[:, 0]) + u[0], 0.3 * u[0]], [[0.3], [0.7]], 0.1 * np.eye(2)


BENT = MixedModel(
    name="bent", nonlinear={"a": "1"}, linear={"z": "1"}, inputs={"u": "1"}, outputs={"y": "1"},
    parameters=[Parameter("p", 0.8, "1", (-2.0, 2.0))],
    dynamics=bent,
    measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.5]], [[0.04]]),
    initial=lambda theta: (Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]),
)  # fmt: skip
STRAIGHT = MixedModel(
    name="straight", nonlinear={"a": "1"}, linear={"z": "1"}, inputs={"u": "1"}, outputs={"y": "1"},
    parameters=[Parameter("p", 0.8, "1", (-2.0, 2.0))],
    dynamics=lambda a, u, t, dt, theta: (
        [theta.p * a[:, 0] + u[0], 0.3 * u[0]], [[0.3], [0.7]], 0.1 * np.eye(2)
    ),
    measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.5]], [[0.04]]),
    initial=lambda theta: (Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]),
)  # fmt: skip


def rng(seed=0):
    return np.random.default_rng(seed)


def smoothed(model, series):
    return engine.rb_ffbsi(engine.rbpf(model, None, series, 20, rng()), 10, rng(), joint=True).a


def estimated(model, series):
    found = engine.rbps_em(model, series, n_iterations=3, n_particles=20, n_trajectories=10)
    return found.theta


STEPPING = {
    "simulate": lambda s: engine.simulate(BENT, None, len(s), rng(), u=s.u, hold=s.hold).y,
    "free_run": lambda s: engine.free_run(BENT, None, s).y,
    "fit_simulation": lambda s: engine.fit_simulation(BENT, s, n_starts=2).theta,
    "kalman_smoother": lambda s: engine.kalman_smoother(STRAIGHT, None, s).log_likelihood,
    "rts_em": lambda s: engine.rts_em(STRAIGHT, s, n_iterations=5).theta,
    "rbpf": lambda s: engine.rbpf(BENT, None, s, 20, rng()).log_likelihood,
    "rb_ffbsi": lambda s: smoothed(BENT, s),
    "rbps_em": lambda s: estimated(BENT, s),
    "quasi_ml": lambda s: quasi_ml(BENT, s).theta,
    "particle_filter": lambda s: (
        engine.particle_filter(as_nonlinear(BENT), None, s, 40, rng()).log_likelihood
    ),
    "ps_em": lambda s: (
        engine.ps_em(BENT, s, n_iterations=2, n_particles=30, n_trajectories=10).theta
    ),
}


@pytest.fixture(scope="module")
def records():
    """A short one, and one that is long enough to be run as a whole."""
    u = np.cumsum(rng(3).standard_normal(400)) * 0.05
    long = Series(engine.simulate(BENT, None, 400, rng(4), u=u).y, u)
    return {True: long, False: long.part(0, 40)}


@pytest.mark.long
@pytest.mark.parametrize("hold", HOLDS[1:])
@pytest.mark.parametrize("name", STEPPING)
def test_whoever_steps_a_model_heeds_it(records, name, hold):
    """As if the inputs over each step had been recorded, for a measurement that does not see them."""
    record = records[name in ("free_run", "fit_simulation")]
    said = record.replace(hold=hold)
    plain = record.replace(u=said.u_step)
    found, expected = STEPPING[name](said), STEPPING[name](plain)
    np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))
    assert not np.array_equal(np.asarray(found), np.asarray(STEPPING[name](record)))


def test_what_is_read_is_the_input_at_the_sample():
    model = MixedModel(
        name="direct", nonlinear={"a": "1"}, linear={"z": "1"}, inputs={"u": "1"}, outputs={"y": "1"},
        parameters=[],
        dynamics=lambda a, u, t, dt, theta: ([u[0], 0.0], [[0.0], [0.0]], np.eye(2)),
        measurement=lambda a, u, t, theta: ([u[0] + 100.0 * a[:, 0]], [[0.0]], [[1.0]]),
        initial=lambda theta: (Gaussian([0.0], [[1.0]]), [0.0], [[1.0]]),
    )  # fmt: skip
    u = np.array([1.0, 3.0, 5.0, 9.0])
    for hold, over in (("zoh", [1, 3, 5]), ("foh", [2, 4, 7]), ("past", [3, 5, 9])):
        run = engine.free_run(model, None, Series(np.zeros(4), u, hold=hold))
        np.testing.assert_allclose(run.y[:, 0], u + 100.0 * np.array([0, *over]))


@pytest.mark.parametrize("hold", HOLDS)
def test_a_finer_grid_follows_the_input(hold):
    """An oscillator against an integrator of differential equations."""
    model, T, dt = get_model("oscillator"), 30, 0.25
    u = rng(1).standard_normal(T)
    t = dt * np.arange(T)

    def between(at):
        k = min(int(at / dt + 1e-9), T - 2)
        if hold == "foh":
            return u[k] + (u[k + 1] - u[k]) * (at - t[k]) / dt
        return u[k] if hold == "zoh" else u[k + 1]

    omega, zeta, gain = 6.0, 0.05, 1.0
    x, exact = np.array([0.1, 0.2]), [0.1]
    for k in range(T - 1):  # piece by piece: the input may jump at a sample
        found = solve_ivp(
            lambda at, x: [x[1], omega**2 * (gain * between(at) - x[0]) - 2 * zeta * omega * x[1]],
            (t[k] + 1e-12, t[k + 1] - 1e-12), x, rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        x = found.y[:, -1]
        exact.append(x[0])
    off = []
    for k in (1, 2, 4, 8):
        series = Series(np.zeros(T), u, dt=dt, hold=hold).refined(k)
        y = engine.free_run(model, None, series, a1=[0.1], z1=[0.2]).y[series.samples, 0]
        off.append(np.abs(y - exact).max())
    if hold == "foh":  # a mean over each step: of second order
        assert off[3] < 0.02 * np.ptp(exact)
        assert all(b < 0.35 * a for a, b in pairwise(off))
    else:
        assert max(off) < 1e-6 * np.ptp(exact)


@pytest.mark.long
@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.mat"])
def test_files_keep_it(tmp_path, hold, name):
    series = Series([1.0, 2.0, 3.0], [0.0, 1.0, 0.0], hold=hold)
    write_series(series, tmp_path / name)
    assert read_series(tmp_path / name).hold == hold
    assert read_series(tmp_path / name, hold="foh").hold == "foh"
    assert Series.read(tmp_path / name).replace(y=series.y).hold == hold


def test_a_column_named_hold_is_a_column():
    assert read_series_bytes(b"t,y,hold\n0,1,5\n1,2,5\n", "a.csv", u=["hold"]).u_names == ("hold",)


def test_parts_and_refinements_keep_it():
    series = Series(np.zeros(6), np.arange(6.0), hold="past")
    assert series.part(1, 4).hold == series.masked([1]).hold == series.refined(2).hold == "past"
    assert series.refined(2).u[:, 0].tolist() == [0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    straight = series.replace(hold="foh").refined(2)
    assert straight.u[:, 0].tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5]
    assert "# hold: past" in csv_text(series)


def test_another_word_is_refused():
    with pytest.raises(OptionError, match="hold = 'linear'; one of zoh, foh, past") as refused:
        Series([1.0, 2.0], hold="linear")
    assert refused.value.field == "hold"
    with pytest.raises(SeriesError, match="hold = 'soft'; one of"):
        read_series_bytes(b"# hold: soft\ny\n1\n2\n", "a.csv")
