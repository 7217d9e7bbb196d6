"""What is said of a diagnosis does not depend on the units, nor on their zero."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import engine
from engine.data.lattice import lattice_step
from engine.data.series import Series
from engine.diagnose.gain.adoption import in_full, in_short
from engine.diagnose.gain.gain import measure_gain
from engine.diagnose.symptoms.data_checks import check_data
from engine.diagnose.symptoms.runs import smoothed
from engine.diagnose.symptoms.symptoms import find_symptoms
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.sigma_point import moment_path
from engine.statespace.model import Theta

T = 240
STEP = 60.0  # s


@dataclass(frozen=True)
class Units:
    """A temperature is ``zero + per_kelvin * K``, a power ``per_watt * W``, a time ``per_second * s``."""

    per_kelvin: float = 1.0
    zero: float = 0.0
    per_watt: float = 1.0
    per_second: float = 1.0

    def temperature(self, kelvin):
        return self.zero + self.per_kelvin * np.asarray(kelvin)


def room(units, sun=0.0):
    """A room heated against 10 degrees outside, and the sun that a base model may not know (``sun`` = 0)."""

    def dynamics(a, u, t, dt, theta):
        air, s = a[:, 0], dt / units.per_second
        heat = 2e-6 * u[0] / units.per_watt + sun * u[1]
        outside = units.temperature(10.0)
        f = [air + s * (theta.loss * units.per_second * (outside - air) + units.per_kelvin * heat)]
        return f, np.zeros((1, 0)), [[1e-4 * units.per_kelvin**2]]

    def measurement(a, u, t, theta):
        return [a[:, 0]], np.zeros((1, 0)), [[0.01 * units.per_kelvin**2]]

    def initial(theta):
        start = engine.Gaussian([units.temperature(20.0)], [[4.0 * units.per_kelvin**2]])
        return start, [], np.zeros((0, 0))

    return engine.MixedModel(
        name="room",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"air": "K"},
        inputs={"heater": "W", "sun": "1"},
        outputs={"reading": "K"},
        parameters=[engine.Parameter("loss", 2e-4 / units.per_second, "1/s", (0.0, np.inf))],
    )


def record():
    """Readings (T,) in kelvin, inputs (T, 2): heated in steps, the sun shines in the middle of each day."""
    rng = np.random.default_rng(4)
    day = np.arange(T) % 80 / 80.0
    sun = np.maximum(np.sin(2.0 * np.pi * (day - 0.25)), 0.0) * (day > 0.25) * (day < 0.75)
    heater = np.repeat(rng.choice([0.0, 500.0, 1500.0], T // 12), 12)
    air, out = 18.0, []
    for power, light in zip(heater, sun, strict=True):
        out.append(air)
        for _ in range(10):
            air += 0.1 * STEP * (2e-4 * (10.0 - air) + 2e-6 * power + 2e-3 * light)
    readings = np.array(out) + 0.1 * rng.standard_normal(T)
    readings[[55, 150]] += 4.0  # spikes
    return readings, np.stack([heater, sun], axis=1)


READINGS, INPUTS = record()


def series(units):
    u = INPUTS * [units.per_watt, 1.0]
    return Series(
        units.temperature(READINGS),
        u,
        dt=STEP * units.per_second,
        y_names=["reading"],
        u_names=["heater", "sun"],
    )


def without_numbers(sentences):
    return [re.sub(r"-?\d[\d.]*(e[+-]?\d+)?", "#", sentence) for sentence in sentences]


def fit(model, units):
    theta = Theta(np.array([2e-4 / units.per_second]), model.parameter_names)
    return QuasiFit(model, theta, 0.0, (), np.zeros((0, 0)), 0, True)


@pytest.fixture(scope="module")
def known():
    return find_symptoms(room(Units()), None, series(Units()))


powers = st.floats(-9.0, 9.0).map(lambda e: 10.0**e)
any_units = st.builds(
    lambda kelvin, shift, watt, second: Units(kelvin, shift * kelvin, watt, second),
    st.floats(0.0, 9.0).map(lambda e: 10.0**e),
    st.sampled_from([0.0, 273.15, -300.0]),
    powers,
    st.sampled_from([1.0, 1.0 / 3.15576e7, 1e6]),
)
far = example(units=Units(1e9, 273.15e9, 1e-9, 1.0 / 3.15576e7))


@pytest.mark.long
@given(units=any_units)
@far
@settings(max_examples=8, deadline=None, derandomize=True)
def test_symptoms_are_the_same_in_other_units(units, known):
    found = find_symptoms(room(units), None, series(units))
    assert known.sentences[0].startswith("Free-run")
    assert len(known.sentences) > 3  # the sun that the model does not know is seen
    assert without_numbers(found.sentences) == without_numbers(known.sentences)
    for one, other in ((found.free_run, known.free_run), (found.one_step, known.one_step)):
        for mine, theirs in zip(one.fits, other.fits, strict=True):
            assert mine.rmse == pytest.approx(theirs.rmse * units.per_kelvin, rel=1e-5)
            assert mine.fit == pytest.approx(theirs.fit, rel=1e-5)
            assert mine.inside == pytest.approx(theirs.inside, abs=0.01)
        assert len(one.regions) == len(other.regions)
        for mine, theirs in zip(one.regions, other.regions, strict=True):
            assert (mine.kind, mine.signal) == (theirs.kind, theirs.signal)
            assert mine.score == pytest.approx(theirs.score, rel=1e-4, abs=1e-4)
            assert mine.share_error == pytest.approx(theirs.share_error, rel=1e-4)
            if mine.kind in ("state", "output"):
                low = units.temperature(theirs.low)
                assert mine.low == pytest.approx(low, abs=1e-4 * units.per_kelvin)
    assert found.whiteness[0].statistic == pytest.approx(known.whiteness[0].statistic, rel=1e-4)


@given(units=any_units)
@far
@settings(max_examples=8, deadline=None, derandomize=True)
def test_notes_on_data_are_the_same_in_other_units(units):
    model = room(units)
    plain = without_numbers(check_data(room(Units()), series(Units())))
    assert plain == ["Output reading: # single readings (# %) more than # robust standard deviations off all "
                     "of the neighbours, the worst by # K at t = # s."]  # fmt: skip
    assert without_numbers(check_data(model, series(units))) == plain
    wave = 20.0 + 3.0 * np.sin(np.arange(T) / 9.0)
    odd = np.minimum(np.round(4.0 * wave) / 4.0, 22.0)
    odd[109:139] = odd[108]
    known = check_data(room(Units()), Series(odd, INPUTS, dt=STEP))
    assert [note.split()[2] for note in known] == ["looks", "stays", "reading"]
    y, u = units.temperature(odd), series(units).u
    found = check_data(model, Series(y, u, dt=STEP * units.per_second))
    assert without_numbers(found) == without_numbers(known)


@given(step=powers, shift=st.sampled_from([0.0, 17.0, -1000.0]))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_the_step_of_a_lattice_is_found_in_any_unit(step, shift):
    counts = np.round(8.0 * np.sin(np.arange(300) / 7.0))
    assert lattice_step(step * (counts + shift)) == pytest.approx(step, rel=1e-6)


@pytest.mark.long
@given(units=any_units)
@far
@settings(max_examples=6, deadline=None, derandomize=True)
def test_a_gain_is_the_same_in_other_units(units):
    def gain(u):
        whole = series(u)
        base, extended = room(u), room(u, sun=2e-3)
        train, test = whole.part(0, 160), whole.part(160, T)
        return measure_gain(fit(base, u), fit(extended, u), [test], train, seed=3)

    found, known = gain(units), gain(Units())
    assert known.adopt
    assert found.decision is known.decision
    assert found.log_density == pytest.approx(known.log_density, rel=1e-5)
    assert found.p_value == pytest.approx(known.p_value, rel=1e-4, abs=1e-12)
    mine, other = found.outputs[0], known.outputs[0]
    assert mine.difference == pytest.approx(other.difference * units.per_kelvin, rel=1e-5)
    assert mine.share_gone == pytest.approx(other.share_gone, rel=1e-5)
    assert (in_short(found), in_full(found)) == (in_short(known), in_full(known))


@pytest.mark.parametrize("scale", [1e-3, 1e9])
def test_a_smoothed_state_does_not_depend_on_the_unit_of_another(scale):
    """Two random walks, one seen beside the other's sum; the unit of the second one is changed."""

    def model(s):
        return engine.MixedModel(
            name="two",
            dynamics=lambda a, u, t, dt, theta: (
                [0.0, 0.0],
                np.eye(2),
                [[theta.q, 0.0], [0.0, 0.5 * s**2]],
            ),
            measurement=lambda a, u, t, theta: ([0.0], [[1.0, 1.0 / s]], [[1.0]]),
            initial=lambda theta: (
                engine.Gaussian([], np.zeros((0, 0))),
                [0.0, 0.0],
                [[4.0, 0.0], [0.0, 9.0 * s**2]],
            ),
            linear={"one": "m", "other": "m"},
            outputs={"y": "m"},
            parameters=[engine.Parameter("q", 0.1, "m^2", (0.0, np.inf))],
        )

    y = Series(np.cumsum(np.random.default_rng(2).standard_normal(60)))
    known, P_known = smoothed(moment_path(model(1.0), np.array([0.1]), y))
    found, P_found = smoothed(moment_path(model(scale), np.array([0.1]), y))
    np.testing.assert_allclose(found / [1.0, scale], known, rtol=1e-6, atol=1e-9)
    diagonal = np.diagonal(P_found, axis1=1, axis2=2) / [1.0, scale**2]
    np.testing.assert_allclose(diagonal, np.diagonal(P_known, axis1=1, axis2=2), rtol=1e-6)
