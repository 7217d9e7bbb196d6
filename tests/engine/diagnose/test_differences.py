"""A parameter that depends on how far two states are apart: a spring that stiffens, what radiates."""

import numpy as np
import pytest

import engine
from engine.diagnose import all_effects, diagnose, make_effect
from engine.diagnose.effects.differences import parts_of, value_of
from engine.diagnose.effects.kinds.parameters import stopped_share
from engine.diagnose.effects.setting import Setting
from engine.diagnose.symptoms.runs import noise_free
from tests.engine.diagnose.test_state_slopes import BODIES, levels, run, setting_of

own = engine.Parameter
NAME = "parameter-slope:|motor-load|->k"
RIVALS = [
    "parameter-slope",
    "parameter-episode",
    "parameter-step",
    "episode",
    "cubic",
    "saturation",
]


def drift(a, u, t, theta):
    twist, slip = a[:, 0] - a[:, 2], a[:, 1] - a[:, 3]
    torque = theta.k * twist + theta.c * slip
    speeds = (u[0] - torque - 0.1 * a[:, 1]) / 0.012, (torque - theta.b * a[:, 3]) / 0.05
    return [a[:, 1], speeds[0], a[:, 3], speeds[1]], np.zeros((4, 0))


# two masses on a shaft; the stiffness is in the equations of both
SHAFT = engine.continuous(
    name="shaft",
    drift=drift,
    diffusion=lambda a, u, t, theta: np.diag([0.0, theta.q, 0.0, 0.1 * theta.q]),
    measurement=lambda a, u, t, theta: ([a[:, 0], a[:, 2]], np.zeros((2, 0)), theta.r * np.eye(2)),
    initial=lambda theta: (engine.Gaussian([0.0] * 4, 1e-4 * np.eye(4)), [], np.zeros((0, 0))),
    nonlinear={"motor": "rad", "turns": "rad/s", "load": "rad", "rate": "rad/s"},
    inputs={"torque": "N m"},
    outputs={"one": "rad", "other": "rad"},
    kinematic=("motor", "load"),
    parameters=[
        own("k", 50.0, "N m/rad", (1.0, 500.0)),
        own("c", 0.05, "N m s/rad", (0.0, 1.0)),
        own("b", 0.2, "N m s/rad", (0.0, 5.0)),
        own("q", 1e-3, "rad^2/s^3", (1e-8, 1.0)),
        own("r", 3e-6, "rad^2", (1e-9, 1e-2)),
    ],
)


def twisted(cubic, seed, n=400):
    rng = np.random.default_rng(seed)
    torque = levels(rng, n, -2.0, 2.0, 25)

    def rate(x, k):
        twist, slip = x[0] - x[2], x[1] - x[3]
        through = 52.0 * twist + cubic * twist**3 + 0.06 * slip
        speeds = (torque[k] - through - 0.1 * x[1]) / 0.012, (through - 0.22 * x[3]) / 0.05
        return [x[1], speeds[0], x[3], speeds[1]]

    x = run(rate, [0.0] * 4, n, 0.004, [0.0, 0.03, 0.0, 0.01], rng)
    y = x[:, [0, 2]] + 0.0017 * rng.standard_normal((n, 2))
    return engine.Series(y, u=torque, dt=0.004)


@pytest.mark.slow
def test_a_shaft_that_stiffens_is_found_and_predicts_the_rest():
    """Named an episode of the stiffness, of the few samples in which the shaft was twisted most."""
    found = diagnose(SHAFT, twisted(5000.0, 21), effects=RIVALS)
    assert [cause.effect for cause in found.causes] == [NAME]
    assert found.adopted


@pytest.mark.long
def test_it_is_asked_of_what_a_parameter_weighs_in_all_equations():
    def asked(model):
        setting = setting_of(
            model, engine.simulate(model, None, 60, 1, u=load(model), dt=0.02).series
        )
        names = [e.channel for e in all_effects(setting, ["parameter-slope"])]
        return [name for name in names if name.startswith("|")]

    def load(model):
        return np.random.default_rng(3).uniform(0.0, 20.0, (60, len(model.inputs)))

    assert asked(SHAFT) == ["|motor-load|->k", "|turns-rate|->c"]
    assert asked(BODIES) == ["|inner-outer|->k", "|outer-air|->h"]  # of a state and an input, too


def test_it_is_what_the_model_does_with_that_parameter_at_each_state():
    effect = make_effect(NAME, Setting(SHAFT))
    assert effect.size.unit == "N m/rad^2"
    model = effect.apply(SHAFT)
    theta = np.array([50.0, 0.05, 0.2, 1e-3, 3e-6, 200.0, 0.01])
    x = np.array([[0.05, 0.0, 0.0, 0.0], [0.0, 0.0, 0.03, 0.0], [0.01, 0.0, 0.0, 0.0]])
    step = model.transition(x, np.array([1.0]), 0.0, 1e-6, model.record(theta))[0]
    for i, apart in enumerate([0.05, 0.03, 0.01]):
        plain = SHAFT.record(np.array([50.0 + 200.0 * (apart - 0.01), *theta[1:5]]))
        alone = SHAFT.transition(x[[i]], np.array([1.0]), 0.0, 1e-6, plain)[0]
        np.testing.assert_allclose(step[i], alone[0], rtol=1e-9, atol=1e-12)


def test_linear_states_are_taken_along_and_an_input_counts():
    series = engine.simulate(BODIES, None, 60, 1, u=np.full((60, 2), [60.0, 10.0]), dt=0.5).series
    for channel in ("|inner-outer|->k", "|outer-air|->h"):
        effect = make_effect(f"parameter-slope:{channel}", setting_of(BODIES, series))
        model = effect.apply(BODIES)
        theta = np.asarray(model.theta())
        start = np.array([40.0, 30.0])
        same, _ = noise_free(model, theta, series, start)
        np.testing.assert_allclose(same, noise_free(BODIES, theta[:4], series, start)[0], rtol=1e-3)
        theta[model.index(effect.size.name)] = 0.1
        assert np.abs(noise_free(model, theta, series, start)[0] - same).max() > 0.01
        assert stopped_share(effect, model, model.theta(theta), series) == 0.0


@pytest.mark.parametrize(
    ("source", "parts"),
    [("|a-b|", ("a", "b")), ("|a-b-c|", ("a-b", "c")), ("|a-a|", ()), ("a", ("a",)), ("|a-x|", ())],
)
def test_names_of_channels_may_have_the_sign(source, parts):
    assert parts_of(source, ["a", "b", "a-b", "c"]) == parts


def test_how_far_two_channels_are_apart():
    values = {"a": np.array([1.0, 4.0]), "b": np.array([3.0, 3.0])}
    np.testing.assert_array_equal(value_of("|a-b|", values), [2.0, 1.0])
    np.testing.assert_array_equal(value_of("a", values), values["a"])
