"""Linear algebra of small matrices in one thread while a model is used, and in as many as before afterwards."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

import engine
from engine.threads import single_threaded

SERVO = engine.get_model("servo")


def threads() -> set[int]:
    """Of every library of linear algebra that is loaded."""
    return {one["num_threads"] for one in ThreadpoolController().select(user_api="blas").info()}


@pytest.fixture
def two():
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("the linear algebra here has but one thread")
        yield


def test_a_model_is_called_with_one_thread(two):
    seen = []

    def measurement(a, u, t, theta):
        seen.append(threads())
        return SERVO.measurement(a, u, t, theta)

    watched = replace(SERVO, measurement=measurement)
    rng = np.random.default_rng(0)
    u = np.zeros((4, len(SERVO.inputs)))
    series = engine.simulate(watched, None, 4, rng, u=u, dt=0.1).series
    engine.rbpf(watched, None, series, 10, rng)
    assert seen
    assert all(each == {1} for each in seen)
    assert threads() == {2}


def test_calls_within_calls_and_errors_lift_the_limit_at_last(two):
    @single_threaded
    def called(depth):
        assert threads() == {1}
        if not depth:
            raise ValueError
        called(depth - 1)

    with pytest.raises(ValueError):
        called(2)
    assert threads() == {2}
