"""What a diagnosis looks at depends neither on the order of a list nor on units, zeros, signs of channels."""

from itertools import permutations

import numpy as np
import pytest

import engine
from engine.data.series import Series
from engine.diagnose.first_states import begins_as_said
from engine.diagnose.records import records_of
from engine.estimation.quasi_ml import quasi_ml

HOURS = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0])


def vat(**changed):
    """Two inputs and two outputs, at rest."""
    fields = {
        "nonlinear": {"x": "K"},
        "inputs": {"a": "W", "b": "W"},
        "outputs": {"y1": "K", "y2": "K"},
        "parameters": [engine.Parameter("k", 0.1, "1/s", (0.0, 1.0))],
    }
    return engine.MixedModel(
        name="vat",
        dynamics=lambda a, u, t, dt, th: (
            [a[:, 0] * (1 - th.k) + u[0]],
            np.zeros((1, 0)),
            [[0.01]],
        ),
        measurement=lambda a, u, t, th: ([a[:, 0], a[:, 0]], np.zeros((2, 0)), np.eye(2)),
        initial=lambda th: (engine.Gaussian([0.0], [[1.0]]), [], np.zeros((0, 0))),
        **{**fields, **changed},
    )


def batch(seed, n=30):
    rng = np.random.default_rng(seed)
    level = rng.normal(size=4)
    y, u = level[:2] + rng.normal(size=(n, 2)), level[2:] + rng.normal(size=(n, 2))
    return Series(y, u, dt=1.0)


def chosen(model, given):
    """The records in the order in which they are searched, and those held out, as numbers of the list."""
    _, records = records_of(model, given, None)
    return records.numbers, records.kept_back


@pytest.mark.parametrize("lengths", [[30] * 5, [30, 30, 31, 29, 29]])
@pytest.mark.parametrize("seed", range(3))
def test_the_same_records_are_chosen_in_whatever_order(lengths, seed):
    given = [batch(10 * seed + k, n) for k, n in enumerate(lengths)]
    expected = chosen(vat(), given)
    assert len(expected[1]) == 1
    for order in list(permutations(range(5)))[::7]:
        found = chosen(vat(), [given[k] for k in order])
        assert tuple(tuple(order[k] for k in part) for part in found) == expected


@pytest.mark.parametrize("seed", range(6))
def test_they_are_in_other_units_from_other_zeros_with_other_signs_and_channels(seed):
    given = [batch(10 * seed + k, 30 + k % 2) for k in range(6)]
    rng = np.random.default_rng(seed)
    size, zero = rng.choice([-1e3, -1.0, 1e-2, 7.0], 4), rng.normal(size=4) * 1e3
    moved = [
        one.replace(y=one.y * size[:2] + zero[:2], u=one.u * size[2:] + zero[2:]) for one in given
    ]
    turned = [one.replace(y=one.y[:, ::-1], u=one.u[:, ::-1]) for one in given]
    unread = [one.replace(y=np.where([True, False], one.y, np.nan)) for one in given]
    alone = [one.replace(y=one.y * [1.0, np.nan] * size[:2]) for one in given]
    idle = [
        one.replace(u=one.u * [1.0, rng.normal()]) for one in given
    ]  # the model reads the first
    assert chosen(vat(), idle) == chosen(vat(), given)
    assert chosen(vat(), moved) == chosen(vat(), given)
    assert chosen(vat(), turned) == chosen(vat(), given)
    assert chosen(vat(), alone) == chosen(vat(), unread)


def bolus():
    """Where what follows the first reading is told by a second state: two compartments."""
    own = engine.Parameter
    return engine.continuous(
        name="bolus",
        drift=lambda a, u, t, th: ([0.0, 0.0], [[-th.k - th.k12, th.k21], [th.k12, -th.k21]]),
        diffusion=lambda a, u, t, th: np.diag([th.q**2, 0.0]),
        measurement=lambda a, u, t, th: ([0.0], [[1.0, 0.0]], [[th.r**2]]),
        initial=lambda th: (None, [2.0, 0.1], np.diag([0.16, 0.01])),
        linear={"blood": "mg/L", "tissue": "mg/L"},
        outputs={"y": "mg/L"},
        parameters=[
            own("k", 0.6, "1/h", (0.0, 10.0)),
            own("k12", 0.1, "1/h", (0.0, 10.0)),
            own("k21", 0.2, "1/h", (0.0, 10.0)),
            own("q", 0.01, "mg/L/h^0.5", (0.0, 1.0)),
            own("r", 0.05, "mg/L", (1e-3, 1.0)),
        ],
    )


def person(first, k, seed, noise=0.05):
    rng = np.random.default_rng(seed)
    y = first * np.exp(-k * HOURS) + noise * rng.standard_normal(len(HOURS))
    return Series(y[:, None], t=HOURS)


@pytest.mark.long
def test_persons_who_differ_otherwise_begin_where_the_model_says_whichever_is_the_first():
    """Fitted to one alone all is far off for the others, which says nothing of where they begin."""
    model = bolus()
    rates = [0.4, 0.8, 0.5, 0.6, 0.7]
    records = [person(2.0 + 0.2 * k, rate, k) for k, rate in enumerate(rates)]
    for one in records:
        fit = quasi_ml(model, one)
        said = [begins_as_said(model, model.theta(), fit.theta, other) for other in records]
        assert sum(said) >= 4  # it was two of five
        for away in (6.0, 9.0):
            other = person(away, 0.6, 100)
            assert not begins_as_said(model, model.theta(), fit.theta, other)


@pytest.mark.slow
def test_a_diagnosis_is_the_same_in_any_order():
    """Irregular records, each on its own clock from 0: the first of them decided how many were searched."""
    records = [person(2.0 + 0.2 * k, rate, k) for k, rate in enumerate([0.3, 0.9, 0.45, 0.6, 0.75])]
    expected, other = (
        engine.diagnose(bolus(), order, effects=["drag"], free=["k", "r"], processes=1)
        for order in (records, records[::-1])
    )
    assert other.verdict is expected.verdict
    assert [c.effect for c in other.causes] == [c.effect for c in expected.causes]
    np.testing.assert_array_equal(np.asarray(other.theta), np.asarray(expected.theta))
    assert other.p_value == expected.p_value


@pytest.mark.parametrize("odd", range(5))
def test_an_odd_record_is_not_the_one_that_all_others_are_compared_with(odd):
    given = [batch(k) for k in range(5)]
    given[odd] = given[odd].replace(y=given[odd].y + 30.0)
    numbers, back = chosen(vat(), given)
    assert numbers[-1] == odd
    assert back != (odd,)


def test_they_are_where_one_is_so_large_that_all_others_are_alike_beside_it():
    """A sensor that once read a million times too much: the order of the list decided between the others."""
    given = [batch(k) for k in range(5)]
    given[3] = given[3].replace(y=np.where(np.arange(30)[:, None] == 7, 1e9, given[3].y))
    expected = chosen(vat(), given)
    for order in list(permutations(range(5)))[::7]:
        found = chosen(vat(), [given[k] for k in order])
        assert tuple(tuple(order[k] for k in part) for part in found) == expected
