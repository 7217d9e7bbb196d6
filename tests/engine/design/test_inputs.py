"""Whatever the shape, the input keeps its bounds; bounds that cannot be used are refused by their field."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.design.bounds import Bounds, InputBounds
from engine.design.inputs import (
    FAMILIES,
    LEAK,
    drawn,
    drawn_plan,
    leakage,
    limited,
    played,
)
from engine.errors import OptionError
from tests.engine.design.models_for_design import drive
from tests.studies.design.cases import random_binary

NUMBERS = st.floats(-5.0, 5.0)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    family=st.sampled_from(sorted(FAMILIES)),
    rate=st.one_of(st.none(), st.floats(0.5, 100.0)),
    band=st.one_of(st.none(), st.tuples(st.floats(-2.5, 1.0), st.floats(0.1, 1.4))),
    start=st.one_of(st.none(), st.just(-3.0), st.just(2.5)),
)
def test_bounds_are_kept(seed, family, rate, band, start):
    bands = () if band is None else ((band[0], band[0] + band[1]),)
    bounds = InputBounds(-3.0, 2.5, rate, bands, start)
    u = played((drawn(np.random.default_rng(seed), family),), [bounds], 200, 0.1)[:, 0]
    _keeps(u, bounds)


def _keeps(u, bounds, dt=0.1):
    assert u.min() >= bounds.low
    assert u.max() <= bounds.high
    for low, high in bounds.forbidden:
        assert not ((u > low) & (u < high)).any()
    if bounds.rate is not None:
        moves = np.abs(np.diff(u if bounds.start is None else np.append(bounds.start, u)))
        assert moves.max() <= bounds.rate * dt * (1.0 + 1e-9)


def test_overlapping_bands_and_bands_over_an_end_are_kept():
    bounds = InputBounds(-3.0, 2.5, None, ((-1.0, 0.0), (-0.5, 1.0), (2.0, 4.0), (-9.0, -2.0)))
    u = limited(np.linspace(-3.0, 2.5, 300), bounds, 0.1)
    _keeps(u, bounds)
    assert sorted({*np.round(u[[0, -1]], 9)}) == [-2.0, 2.0]


def test_an_input_waits_at_a_band_that_it_cannot_jump():
    slow = InputBounds(-3.0, 3.0, 1.0, ((-1.0, 1.0),), -3.0)
    u = limited(np.full(100, 3.0), slow, 0.1)
    _keeps(u, slow)
    assert u[-1] == -1.0
    fast = InputBounds(-3.0, 3.0, 30.0, ((-1.0, 1.0),), -3.0)
    assert limited(np.full(100, 3.0), fast, 0.1)[-1] == 3.0


def test_what_lies_in_a_stop_band_is_its_share_of_the_power():
    t = np.arange(400) * 0.1
    two = 1.0 + 2.0 * np.sin(2 * np.pi * 0.5 * t) + np.sin(2 * np.pi * 2.0 * t)
    assert leakage(two, InputBounds(-3.0, 4.0), 0.1) == 0.0
    around = InputBounds(-3.0, 4.0, stopbands=((1.8, 2.2),))
    assert leakage(two, around, 0.1) == pytest.approx(0.2, abs=0.02)
    between = InputBounds(-3.0, 4.0, stopbands=((2.0, 2.0001),))  # narrower than the record tells
    assert leakage(two, between, 0.1) > 0.04
    assert leakage(np.full(400, 0.3) + 1e-14 * two, around, 0.1) == 0.0


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_stop_bands_are_left_alone_and_the_range_is_kept(family):
    bounds = InputBounds(-3.0, 2.5, stopbands=((0.3, 0.6), (2.0, 3.0)))
    free = InputBounds(-3.0, 2.5)
    kept = 0
    for seed in range(8):
        plan = (drawn(np.random.default_rng(seed), family),)
        u = played(plan, [bounds], 300, 0.1)[:, 0]
        _keeps(u, bounds)
        left, before = (
            leakage(one, bounds, 0.1) for one in (u, played(plan, [free], 300, 0.1)[:, 0])
        )
        assert left <= max(before, LEAK)
        kept += left <= LEAK
    assert kept >= 6


def test_random_binary_takes_both_ends():
    u = random_binary([InputBounds(-3.0, 2.5)], 100, 0.1, 4, np.random.default_rng(0))
    assert set(u[:, 0]) == {-3.0, 2.5}
    assert (u.reshape(25, 4) == u[::4]).all()


def test_several_inputs_have_shapes_of_their_own():
    rng = np.random.default_rng(1)
    plan = drawn_plan(rng, "steps", 3)
    u = played(plan, [InputBounds(0.0, 1.0)] * 3, 100, 0.1)
    assert u.shape == (100, 3)
    assert "steps" in [shape.family for shape in plan]


GOOD = {"low": -1.0, "high": 1.0}


@pytest.mark.parametrize(
    ("given_", "field"),
    [
        ({"inputs": {"voltage": [1.0, -1.0]}}, "bounds.inputs.voltage.low"),
        ({"inputs": {"voltage": {"low": -1.0}}}, "bounds.inputs.voltage.high"),
        ({"inputs": {"voltage": {**GOOD, "rate": 0.0}}}, "bounds.inputs.voltage.rate"),
        ({"inputs": {"voltage": {**GOOD, "rate": "fast"}}}, "bounds.inputs.voltage.rate"),
        ({"inputs": {"voltage": {**GOOD, "speed": 1.0}}}, "bounds.inputs.voltage.speed"),
        ({"inputs": {"voltage": {**GOOD, "low": float("nan")}}}, "bounds.inputs.voltage.low"),
        ({"inputs": {"voltage": {**GOOD, "start": 3.0}}}, "bounds.inputs.voltage.start"),
        (
            {"inputs": {"voltage": {**GOOD, "start": 0.0, "forbidden": [[-0.5, 0.5]]}}},
            "bounds.inputs.voltage.start",
        ),
        (
            {"inputs": {"voltage": {**GOOD, "forbidden": [[-2.0, 2.0]]}}},
            "bounds.inputs.voltage.forbidden",
        ),
        (
            {"inputs": {"voltage": {**GOOD, "forbidden": [[0.5, 0.1]]}}},
            "bounds.inputs.voltage.forbidden[0]",
        ),
        (
            {"inputs": {"voltage": {**GOOD, "stopbands": [[3.0, 2.0]]}}},
            "bounds.inputs.voltage.stopbands[0]",
        ),
        (
            {"inputs": {"voltage": {**GOOD, "stopbands": [[-1.0, 2.0]]}}},
            "bounds.inputs.voltage.stopbands[0]",
        ),
        ({"inputs": {"voltage": 3.0}}, "bounds.inputs.voltage"),
        ({"inputs": {"voltage": GOOD}, "hold": "linear"}, "bounds.hold"),
        ({"inputs": {"voltage": GOOD}, "substeps": 0}, "bounds.substeps"),
        ({"inputs": [1.0]}, "bounds.inputs"),
        ({"inputs": {}}, "bounds.inputs.voltage"),
        ({"inputs": {"voltage": GOOD, "current": GOOD}}, "bounds.inputs.current"),
        ({"inputs": {"voltage": GOOD}, "states": {"speed": [0, 1]}}, "bounds.states.speed"),
        ({"inputs": {"voltage": GOOD}, "states": {"velocity": [1, 0]}}, "bounds.states.velocity"),
        ({"inputs": {"voltage": GOOD}, "outputs": {"tacho": "low"}}, "bounds.outputs.tacho"),
        ({"inputs": {"voltage": GOOD}, "dt": -1.0}, "bounds.dt"),
        ({"inputs": {"voltage": GOOD}, "sigmas": -1.0}, "bounds.sigmas"),
        ({"inputs": {"voltage": GOOD}, "forbidden": 1}, "bounds.forbidden"),
        ({"dt": 1.0}, "bounds.inputs"),
        ([1.0], "bounds"),
    ],
)
def test_what_cannot_be_used_is_refused_by_its_field(given_, field):
    with pytest.raises(OptionError) as refused:
        Bounds.of(given_).check(drive())
    assert refused.value.field == field
    assert field.partition("[")[0] in str(refused.value)


def test_bounds_go_through_json():
    bounds = Bounds.of(
        {
            "inputs": {
                "voltage": {
                    **GOOD,
                    "rate": 2.0,
                    "forbidden": [[-0.5, 0.5]],
                    "start": 1.0,
                    "stopbands": [[1, 2]],
                }
            },
            "states": {"velocity": [None, 2.0]},
            "dt": 0.1,
            "hold": "foh",
            "substeps": 3,
        }
    )
    assert Bounds.of(bounds.to_dict()) == bounds
