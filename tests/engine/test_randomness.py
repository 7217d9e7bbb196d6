"""What users give for random numbers: a seed, a generator, or something else."""

import numpy as np
import pytest

import engine
from engine.errors import OptionError

LEVEL = engine.get_model("local-level")
SERIES = engine.simulate(LEVEL, None, 40, 1).series


def smoothed(rng):
    filtered = engine.rbpf(LEVEL, None, SERIES, 8, 0)
    return engine.rb_ffbsi(filtered, 5, rng).z


RNGS = {
    "simulate": lambda rng: engine.simulate(LEVEL, None, 40, rng).y,
    "rbpf": lambda rng: engine.rbpf(LEVEL, None, SERIES, 8, rng).log_likelihood,
    "rb_ffbsi": smoothed,
}

SEEDS = {
    "rbps_em": lambda seed: engine.rbps_em(LEVEL, SERIES, seed=seed),
    "fit_simulation": lambda seed: engine.fit_simulation(LEVEL, SERIES, seed=seed),
    "standard_errors": lambda seed: engine.standard_errors(LEVEL, None, SERIES, seed=seed),
    "diagnose": lambda seed: engine.diagnose(LEVEL, SERIES, seed=seed),
}


@pytest.mark.parametrize("use", RNGS)
def test_a_seed_stands_for_its_generator(use):
    np.testing.assert_array_equal(RNGS[use](3), RNGS[use](np.random.default_rng(3)))


@pytest.mark.parametrize("use", RNGS)
@pytest.mark.parametrize("wrong", [-1, 0.5, None, True, np.random])
def test_what_is_no_generator_is_refused(use, wrong):
    with pytest.raises(OptionError, match=r"rng = .*whole number from 0 on or a numpy") as error:
        RNGS[use](wrong)
    assert error.value.field == "rng"


@pytest.mark.parametrize("use", SEEDS)
@pytest.mark.parametrize("wrong", [-1, 0.5, None])
def test_what_is_no_seed_is_refused(use, wrong):
    with pytest.raises(
        OptionError, match=r"seed = .*; a whole number from 0 on is needed"
    ) as error:
        SEEDS[use](wrong)
    assert error.value.field == "seed"
