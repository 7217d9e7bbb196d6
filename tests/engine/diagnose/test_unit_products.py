"""Products of units, as they stand beside sizes of effects."""

import pytest

from engine.units import product


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ((("m/s"), ("s", -1)), "m/s^2"),
        ((("", 2), ("s", -1)), "1/s"),
        ((("m/s", 2),), "m^2/s^2"),
        ((("V^0.5/s", 2),), "V/s^2"),
        (("m/s", ("s", -1), ("m/s", -3)), "s/m^2"),
        (("N s/m", "m"), "N s"),
        (("1e8 m^3", ("s", -1)), "1e8 m^3/s"),
        ((("1e8 m^3", 2),), "1e16 m^6"),
        (("W/(m K)", ("s", -1)), "W/m/K/s"),
        (("J*s", ("s", -1)), "J"),
        (("degC", ("%", -1)), "degC/%"),
        (("1", ("1", -2)), "1"),
        (("m (s", ("s", -1)), "(m (s)/s"),
        (("m//s", ("m//s", -1)), "1"),
        (("log ppb", ("d", -1)), "(log ppb)/d"),
        ((("log ppb", -2), ("d", -1)), "1/(log ppb)^2/d"),
        (("log10(1/month)", ("year", -1)), "(log10(1/month))/year"),
        (("ln(kg)", ("ln kg", -1)), "1"),
        (("log ppb/degF", "degF"), "log ppb"),
        (("(log ppb)^2/d", ("log ppb", -1)), "(log ppb)/d"),
        (("log", ("s", -1)), "log/s"),
    ],
)
def test_products(factors, expected):
    assert product(*factors) == expected
