"""An estimation says where a record begins elsewhere than the model's first state says."""

import numpy as np
import pytest

import engine
from engine.estimation.beginnings import about_beginnings, about_cuts
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.other_units import Units

ELSEWHERE = "where the model's first state says that none does"


def block(spread=0.1):
    """A heated block, at rest at first."""
    return engine.MixedModel(
        name="block",
        dynamics=lambda a, u, t, dt, th: (
            [dt * u[0] / th.C],
            [[1.0 - dt * th.k]],
            [[th.q**2]],
        ),
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r**2]]),
        initial=lambda th: (None, [0.0], [[spread**2]]),
        linear={"excess": "K"},
        inputs={"heater": "W"},
        outputs={"probe": "K"},
        parameters=[
            engine.Parameter("C", 60.0, "J/K", (10.0, 500.0)),
            engine.Parameter("k", 0.01, "1/s", (0.0, 0.1)),
            engine.Parameter("q", 0.01, "K", (0.0, 5.0)),
            engine.Parameter("r", 0.05, "K", (1e-4, 5.0)),
        ],
    )


def heated(seed=1, n=200):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(2.0, 12.0, n // 20), 20)
    truth = {"C": 50.0, "k": 0.005, "q": 0.02, "r": 0.05}
    return engine.simulate(block(), truth, n, rng, u=u, dt=5.0).series


def about(model, listed):
    return about_beginnings(model, quasi_ml(model, listed).theta, listed)


def test_a_record_cut_in_two_is_told_in_any_order():
    parts = [heated().part(0, 100), heated().part(100, 200)]
    for listed, said in (
        (parts, ["0, 1 begins", "record 1 begins where 0 ends"]),
        (parts[::-1], ["0, 0 begins", "record 0 begins where 1 ends"]),
        (parts[1:], ["The record begins"]),
    ):
        text = about(block(), listed)
        assert ELSEWHERE in text
        assert all(each in text for each in said)


def test_nothing_is_said_where_records_begin_as_the_model_says():
    whole = heated()
    assert about(block(), [whole]) == ""
    assert about(block(), [whole, heated(2)]) == ""
    assert about(block(spread=50.0), [whole.part(0, 100), whole.part(100, 200)]) == ""


def test_only_parts_that_follow_one_another_are_said_to():
    whole = heated()
    first, second, late = whole.part(0, 80), whole.part(80, 160), whole.part(165, 200)
    assert about_cuts([first, late], range(2)) == ""
    assert about_cuts([first, second], [1], [4, 7]) == (
        " In time, record 7 begins where 4 ends: give what is one record as one."
    )


def test_of_many_records_some_are_told_by_their_numbers():
    """A thousand took 9 s and 13,000 letters."""
    whole = heated()
    many = [whole.part(k, k + 20) for k in range(100, 180)]
    text = about_beginnings(block(), block().theta(), many)
    assert text.startswith("All 80 records begin where")
    assert text.endswith("24 begins where 4 ends and 55 more: give what is one record as one.")
    at_rest = [whole.part(0, 20).replace(y=whole.y[:20] + 1e-6 * k) for k in range(3)]
    text = about_beginnings(block(), block().theta(), [*at_rest, *many[:20]])
    assert "counted from 0, 3, 4, 5, 6, 7 and 15 more begin where" in text


@pytest.mark.long
def test_nothing_is_said_of_records_of_the_model_itself():
    for seed in range(40):
        listed = [heated(seed, 60), heated(100 + seed, 60)]
        assert about(block(), listed) == ""


def test_units_change_nothing():
    model, series = block(), [heated().part(0, 100), heated().part(100, 200)]
    units = Units.of(model, iter([3, -4, 2, 0, 0, 0, 0, 5]).__next__)
    theta = quasi_ml(model, series).theta
    moved = [units.series(one) for one in series]
    text = about_beginnings(units.model(model), np.asarray(theta) * units.theta, moved)
    assert text == about_beginnings(model, theta, series)


@pytest.mark.long
def test_estimations_say_so():
    """C was 37 J/K where 50 is right, without a word."""
    parts = [heated().part(0, 100), heated().part(100, 200)]
    assert ELSEWHERE in engine.rts_em(block(), parts).message
    assert ELSEWHERE not in engine.rts_em(block(), heated()).message
