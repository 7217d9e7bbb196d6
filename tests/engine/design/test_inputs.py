"""Whatever the shape, the input keeps its bounds; bounds that cannot be used are refused by their field."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.design.bounds import Bounds, InputBounds
from engine.design.inputs import FAMILIES, drawn, drawn_plan, limited, played, random_binary
from engine.errors import OptionError
from tests.engine.design.models_for_design import drive

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
        ({"inputs": {"voltage": 3.0}}, "bounds.inputs.voltage"),
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
            "inputs": {"voltage": {**GOOD, "rate": 2.0, "forbidden": [[-0.5, 0.5]], "start": 1.0}},
            "states": {"velocity": [None, 2.0]},
            "dt": 0.1,
        }
    )
    assert Bounds.of(bounds.to_dict()) == bounds
