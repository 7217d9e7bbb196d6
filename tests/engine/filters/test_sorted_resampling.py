"""Resampling along a curve: an order that keeps neighbours together, and a likelihood that hardly jumps."""

import numpy as np
import pytest

import engine
from engine.kernels.curve import along_curve


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_the_order_keeps_neighbours_and_does_not_ask_for_units(n):
    x = np.random.default_rng(n).normal(size=(400, n))
    order = along_curve(x)
    assert sorted(order.tolist()) == list(range(400))
    scale, zero = 10.0 ** np.linspace(-9.0, 6.0, n), np.linspace(-3.0, 20.0, n)
    assert along_curve(scale * (x + zero)).tolist() == order.tolist()

    def length(path):
        return np.linalg.norm(np.diff(path, axis=0), axis=1).mean()

    assert length(x[order]) < 0.8 * length(x)
    if n == 1:
        assert order.tolist() == np.argsort(x[:, 0]).tolist()
    if n == 2:
        assert length(x[order]) < 0.2 * length(x)


@pytest.mark.long
def test_coordinates_without_spread_are_left_out():
    x = np.random.default_rng(0).normal(size=(50, 3))
    x[:, [0, 2]] = [1e9 / 3.0, 0.0]
    assert along_curve(x).tolist() == np.argsort(x[:, 1]).tolist()
    assert along_curve(x[:, :1]).tolist() == list(range(50))
    x[:, 1] = np.inf
    assert sorted(along_curve(x).tolist()) == list(range(50))


@pytest.mark.long
def test_with_the_same_random_numbers_the_likelihood_hardly_jumps():
    """Along a thousandth of a parameter's size it leaves a parabola by less than that of the plain scheme."""
    model = engine.get_model("mixed-4")
    series = engine.simulate(model, None, 100, 1).series

    def jumps(**options):
        at = model.theta().asdict()
        name = model.parameter_names[0]
        ways = np.linspace(-1e-3, 1e-3, 41) * max(abs(at[name]), 1e-3)
        values = [
            engine.rbpf(
                model, {**at, name: at[name] + way}, series, 100, 3, **options
            ).log_likelihood
            for way in ways
        ]
        line = np.polyval(np.polyfit(ways, values, 2), ways)
        return float(np.std(values - line))

    rough = jumps(ess_threshold=1.0)
    assert jumps(resampling="sorted", ess_threshold=1.0) < 0.7 * rough
