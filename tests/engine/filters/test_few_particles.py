"""Particles that nothing moves apart are told: their spread is none."""

from __future__ import annotations

from typing import Any

import numpy as np

import engine


def model_with(q: float, first: Any = None) -> engine.MixedModel:
    """A nonlinear state that decays, with noise of variance q."""

    def dynamics(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [0.9 * a[:, 0], 0.0], [[0.0], [0.5]], [[q, 0.0], [0.0, 1e-4]]

    def measurement(a: Any, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        return [a[:, 0]], [[1.0]], [[1e-4]]

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        return first or engine.Gaussian([0.0], [[100.0]]), [0.0], [[100.0]]

    return engine.MixedModel(
        name="still",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"a": "1"},
        linear={"z": "1"},
        outputs={"y": "1"},
        parameters=[],
    )


class TwoValues:
    """A state that is one or the other from the start."""

    def sample(self, rng: np.random.Generator, n: int) -> Any:
        return rng.integers(0, 2, (n, 1)).astype(float)

    def log_density(self, a: Any) -> Any:
        return np.full(len(a), np.log(0.5))


SERIES = engine.Series(3.0 * 0.9 ** np.arange(60.0))


def test_particles_that_no_noise_moves_apart() -> None:
    filtered = engine.rbpf(model_with(0.0), None, SERIES, 100, 1)
    assert len(np.unique(filtered.a[-1])) < 10 < len(np.unique(filtered.a[0]))
    assert "no noise moves them apart" in filtered.note
    assert "no noise moves them apart" in " ".join(str(filtered).split())


def test_particles_that_noise_moves_apart() -> None:
    assert "apart" not in engine.rbpf(model_with(1e-6), None, SERIES, 100, 1).note


def test_a_state_of_two_values() -> None:
    assert "apart" not in engine.rbpf(model_with(0.0, TwoValues()), None, SERIES, 100, 1).note
