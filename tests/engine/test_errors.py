"""Each error of options and series, with its message: what was wrong, where, what to do."""

from __future__ import annotations

import numpy as np
import pytest

from engine import (
    OptionError,
    Series,
    SeriesError,
    get_model,
    kalman_smoother,
    rb_ffbsi,
    rbpf,
    rbps_em,
    rts_em,
)
from engine.errors import EngineError, ModelError
from engine.estimation.em import Checkpoint

Y = np.zeros(10)
NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"y": [1.0]}, "y has 1 samples; at least 2 are needed"),
        ({"y": np.zeros((3, 2, 1))}, r"y has shape \(3, 2, 1\); \(T, ny\) is needed"),
        ({"y": [[1.0], ["x"]]}, "y is not a table of numbers"),
        ({"y": [[1.0], [2.0, 3.0]]}, "y is not a table of numbers"),
        ({"y": Y, "u": np.zeros(9)}, "u has 9 rows and y has 10; they must be equal"),
        ({"y": [0.0, INF]}, "y is infinite at row 1, channel 'y'; use NaN for a missing value"),
        (
            {"y": np.array([[0, 0], [0, -INF]]), "y_names": ["v", "w"]},
            "y is infinite at row 1, channel 'w'",
        ),
        (
            {"y": [0.0, 1.0], "u": [0.0, NAN]},
            "u is not finite at row 1, channel 'u'; an input must be known at every sample",
        ),
        ({"y": Y, "y_names": ["a", "b"]}, "2 names were given for 1 channels of y"),
        ({"y": Y, "u": Y, "u_names": []}, "0 names were given for 1 channels of u"),
        ({"y": Y, "dt": 0.0}, "dt = 0.0; a positive time step is needed"),
        ({"y": Y, "dt": NAN}, "dt = nan; a positive time step is needed"),
        ({"y": Y, "t": np.arange(9)}, "t has 9 time stamps and y has 10 rows"),
        ({"y": [0, 0, 0], "t": [0, NAN, 1]}, "t is not finite at row 1"),
        ({"y": [0, 0, 0], "t": [0, 1, 1]}, r"t repeats at row 2 \(1\); time must increase"),
        (
            {"y": [0, 0, 0], "t": [0, 2, 1]},
            r"t decreases at row 2 \(1\); time must increase; .*sort them",
        ),
    ],
)
def test_series(arguments, message):
    with pytest.raises(SeriesError, match=message):
        Series(**arguments)


MODEL = get_model("linear-2")
SERIES = Series(Y)


@pytest.mark.parametrize(
    ("series", "message"),
    [
        (Series(np.zeros((10, 2))), r"y has 2 channels; model 'linear-2' needs 1 \(y\)"),
        (Series(Y, Y), r"u has 1 channels; model 'linear-2' needs 0 \(none\)"),
        (Series(np.full(10, NAN)), "every value of y is missing; at least one measurement"),
        ([], "no series was given; at least one is needed"),
        ([SERIES, Series(np.zeros((10, 3)))], "y has 3 channels"),
    ],
)
def test_series_that_do_not_fit_the_model(series, message):
    for call in (rbps_em, rts_em):
        with pytest.raises(SeriesError, match=message):
            call(MODEL, series)


def checkpoint(trace, k):
    return Checkpoint(np.asarray(trace, dtype=float), *(np.zeros(k) for _ in range(4)))


@pytest.mark.parametrize(
    ("options", "field", "message"),
    [
        ({"n_particles": 0}, "n_particles", "n_particles = 0; a positive whole number"),
        ({"n_particles": 2.5}, "n_particles", "n_particles = 2.5; a positive whole number"),
        ({"n_trajectories": 0}, "n_trajectories", "n_trajectories = 0; a positive whole number"),
        ({"n_trajectories": 1.5}, "n_trajectories", "n_trajectories = 1.5; a positive whole"),
        ({"n_iterations": 0}, "n_iterations", "n_iterations = 0; a positive whole number"),
        ({"n_iterations": 1.5}, "n_iterations", "n_iterations = 1.5; a positive whole number"),
        (
            {"resampling": "wheel"},
            "resampling",
            "'wheel' is not known; use multinomial, stratified, systematic, residual, sorted",
        ),
        ({"ess_threshold": 1.5}, "ess_threshold", r"1.5 is not within \[0, 1\]"),
        ({"ess_threshold": NAN}, "ess_threshold", r"nan is not within \[0, 1\]"),
        ({"proposal": "psychic"}, "proposal", "'psychic' is not known; use adapted or bootstrap"),
        ({"smoother": "rts"}, "smoother", "'rts' is not known; use exact or algorithm-3"),
        ({"m_step": "newton"}, "m_step", "'newton' is not known; use scoring or bfgs"),
        ({"free": ["thta"]}, "thta", "no parameter 'thta'; it has theta"),
        ({"theta0": {"k": 1.0}}, "k", "no parameter 'k'; it has theta"),
        ({"theta0": [1.0, 2.0]}, "theta", "theta has 2 values; model 'linear-2' has 1 parameters"),
        ({"theta0": [9.0]}, "theta", r"'theta' = 9 is not within \[-2, 2\]"),
        ({"theta0": [NAN]}, "theta", "'theta' = nan is not within"),
        (
            {"resume": checkpoint([[0.1], [0.2]], 3)},
            "resume",
            r"resume has a trace of shape \(2, 1\) and 3 log-likelihoods",
        ),
        ({"resume": checkpoint(np.zeros((2, 4)), 1)}, "resume", r"needs \(k \+ 1, 1\) and k"),
    ],
)
def test_options_of_rbps_em(options, field, message):
    with pytest.raises(OptionError, match=message) as caught:
        rbps_em(MODEL, SERIES, **{"n_iterations": 1, "n_particles": 5, **options})
    assert caught.value.field == field


def test_options_of_filter_and_smoother():
    rng = np.random.default_rng(0)
    with pytest.raises(OptionError, match="n_particles = -1"):
        rbpf(MODEL, None, SERIES, -1, rng)
    f = rbpf(MODEL, None, SERIES, 5, rng)
    with pytest.raises(OptionError, match="n_trajectories = 0"):
        rb_ffbsi(f, 0, rng)


def test_unknown_model():
    with pytest.raises(
        OptionError, match=r"no model is registered as .mixed-5.; there are .*mixed-4"
    ):
        get_model("mixed-5")


def test_the_kalman_smoother_refuses_what_is_not_linear_gaussian():
    model = get_model("mixed-4")
    with pytest.raises(ModelError, match="'mixed-4' is not linear Gaussian: h is not affine in a"):
        kalman_smoother(model, None, Series(np.zeros((10, 2))))
    with pytest.raises(ModelError, match="is not linear Gaussian"):
        rts_em(model, Series(np.zeros((10, 2))), n_iterations=1)


def test_all_errors_are_engine_errors():
    for error in (ModelError, SeriesError, OptionError):
        assert issubclass(error, EngineError)
        assert issubclass(error, ValueError)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"theta0": {"q": "x"}}, "q = 'x'; a number is needed"),
        ({"theta0": ["a", "b"]}, r"theta = \['a', 'b'\]; a vector of numbers is needed"),
        ({"n_particles": 10.5}, "n_particles = 10.5; a positive whole number is needed"),
        ({"n_particles": "many"}, "n_particles = 'many'; a positive whole number is needed"),
        ({"free": "q"}, r"free = 'q'; a list of names is needed, \['q'\] of one"),
    ],
)
def test_what_is_no_number_is_no_traceback(given, told):
    with pytest.raises(OptionError, match=told):
        rbps_em(get_model("local-level"), Series(np.ones(9)), **given)


def test_an_array_is_no_series():
    with pytest.raises(SeriesError, match="the data are of type ndarray; a series is needed"):
        rbps_em(get_model("local-level"), np.ones(9))
