"""An effect hidden in a record, over HTTP: diagnosed, its extension estimated by RBPS-EM, run and judged."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine
from engine.diagnose.effects.catalogue import extend
from engine.diagnose.effects.setting import Setting

T, DT, CUBIC, NOISE = 100, 0.2, -30.0, 3e-3
# of a force that nobody knows; without any, those particles that begin near the truth have to do for all times
PUSH = {"pushed": (0.006, 30), "not pushed": (0.0, 200)}


@pytest.fixture(scope="module", params=PUSH)
def pushed(request):
    """Size of the force that nobody knows, and the particles that are enough for it."""
    return PUSH[request.param]


@pytest.fixture(scope="module")
def record(pushed):
    """x'' = -36 x - 0.6 x' - 30 x^3 + 36 (u + w) by another program, u and w held; the model has no x^3."""
    rng = np.random.default_rng(4)
    u = np.convolve(rng.standard_normal(T + 8), np.ones(8) / 8.0)[8 : T + 8]
    w = pushed[0] * np.random.default_rng(5).standard_normal(T)
    y, x = np.zeros(T), np.zeros(2)
    for k in range(T):
        y[k] = x[0]
        x = solve_ivp(
            lambda t, s, push=36.0 * (u[k] + w[k]): [
                s[1],
                push - 36.0 * s[0] - 0.6 * s[1] + CUBIC * s[0] ** 3,
            ],
            (0.0, DT),
            x,
            rtol=1e-9,
            atol=1e-12,
        ).y[:, -1]
    y += NOISE * rng.standard_normal(T)
    return {"y": y.tolist(), "u": u.tolist(), "dt": DT}


def run(client, ended, job):
    answer = client.post("/jobs", json=job)
    assert answer.status_code == 201, answer.text
    url = answer.headers["location"]
    done = ended(client, url, 240.0)
    assert done["status"] == "successful", done["message"]
    return url, client.get(f"{url}/results").json()


@pytest.mark.slow
def test_a_hidden_effect_is_found_estimated_and_simulated(client, ended, record, pushed):
    _, found = run(
        client,
        ended,
        {
            "kind": "diagnose",
            "model": "oscillator",
            "series": [record],
            "options": {"effects": ["cubic", "quadratic", "force", "bias"], "seed": 1},
        },
    )
    found = found["diagnosis"]
    assert found["verdict"] in ("named", "set")
    assert [cause["effect"] for cause in found["causes"]] == ["cubic:position->velocity"]
    assert found["gain"]["adopt"]
    reference, theta = found["extension"]["model"], found["extension"]["theta"]
    assert reference["setting"]["substeps"] > 1  # the cubic force acts within a sample

    extended = {"model": reference, "series": [record]}
    url, fitted = run(
        client,
        ended,
        extended
        | {
            "kind": "estimate",
            "parameters": {"start": theta},
            "options": {
                "particles": pushed[1],
                "iterations": 25,
                "seed": 1,
                "intervals": "symmetric",
            },
        },
    )
    cubic = fitted["estimate"]["cubic_position__velocity"]
    assert cubic["value"] == pytest.approx(CUBIC, rel=0.1)
    assert 0.0 < cubic["standard_error"] < 0.1 * abs(CUBIC)
    assert theta["cubic_position__velocity"] == pytest.approx(cubic["value"], rel=0.1)
    trace = client.get(f"{url}/trace").json()
    assert len(trace["log_likelihood"]) == len(trace["theta"]["cubic_position__velocity"]) > 1
    assert len(fitted["states"]["series"][0]["t"]) == T  # at the samples, whatever the steps

    errors = []
    for model, values in (
        ("oscillator", found["base_theta"]),
        (reference, {name: one["value"] for name, one in fitted["estimate"].items()}),
    ):
        _, simulated = run(
            client,
            ended,
            {
                "kind": "simulate",
                "model": model,
                "series": [record],
                "parameters": {"values": values},
                "options": {"mode": "free-run"},
            },
        )
        one = simulated["simulation"]["series"][0]
        assert len(one["t"]) == len(one["y"]["y"]) == T
        errors.append(one["rmse"])
    assert errors[1] < 0.25 * errors[0]


def driven_with_dry_friction(friction, seed=7):
    """M v' = k u - c v - friction sign(v) by Euler's rule at a 40th of the sample; it sticks at rest."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-6.0, 6.0, 20), 20)
    dt, fine = 0.02, 40
    h, x, v, y = dt / fine, 0.0, 0.0, np.zeros(len(u))
    for k, volts in enumerate(u):
        y[k] = x + 2e-4 * rng.standard_normal()
        for _ in range(fine):
            push = 35.0 * volts - 210.0 * v
            way = np.sign(v) or np.sign(push)
            if v == 0.0 and abs(push) <= friction:
                continue
            after = (
                v + h * (push - way * friction) / 95.0 + 0.02 * np.sqrt(h) * rng.standard_normal()
            )
            after = 0.0 if after * v < 0.0 else after
            x, v = x + 0.5 * h * (v + after), after
    return {"y": y.tolist(), "u": u.tolist(), "dt": dt}


@pytest.mark.slow
def test_dry_friction_is_found_and_estimated_by_particles(client, ended):
    """What jumps at a sign has no slopes there; the particles need none."""
    record = driven_with_dry_friction(25.0)
    free = ["M", "Fv", "sigma_v", "sigma_y"]  # of its forces only ratios show: the motor's is known
    _, found = run(
        client,
        ended,
        {
            "kind": "diagnose",
            "model": "servo",
            "series": [record],
            "parameters": {"start": {"Fc": 0.0, "offset": 0.0, "sigma_load": 0.0}, "free": free},
            "options": {
                "effects": ["coulomb", "drag", "bias", "input-gain", "input-deadzone", "held"],
                "seed": 1,
            },
        },
    )
    found = found["diagnosis"]
    (cause,) = found["causes"]
    # what the model has is preferred; a friction that holds what stands differs from it by little
    assert found["verdict"] in ("named", "set")
    assert cause["effect"] == "held:Fc"
    assert found["gain"]["adopt"]
    _, fitted = run(
        client,
        ended,
        {
            "kind": "estimate",
            "model": found["extension"]["model"],
            "series": [record],
            "parameters": {"start": found["extension"]["theta"], "free": [*free, "held_Fc"]},
            "options": {"particles": 50, "iterations": 25, "seed": 1, "intervals": "symmetric"},
        },
    )
    friction = fitted["estimate"]["held_Fc"]
    for one in (cause["size"], friction["value"]):
        assert one == pytest.approx(25.0, abs=3.0 * friction["standard_error"])
    assert 0.0 < friction["standard_error"] < 3.0


@pytest.mark.slow
def test_steps_within_a_sample_are_those_of_the_library(client, ended, record):
    """The same run as in the library on the refined series; a model without a real time step refuses them."""
    setting = {"scale": {}, "span": [0.0, DT * (T - 1)], "dt": DT, "substeps": 4}
    reference = {"name": "oscillator", "with": ["cubic:position->velocity"], "setting": setting}
    job = {
        "kind": "simulate",
        "model": reference,
        "series": [record],
        "parameters": {"values": {"cubic_position__velocity": CUBIC}},
        "options": {"mode": "free-run"},
    }
    _, there = run(client, ended, job)
    base = engine.get_model("oscillator")
    told = Setting(base, {}, (0.0, DT * (T - 1)), DT, substeps=4)
    model = extend(base, reference["with"], told)
    series = engine.Series(record["y"], record["u"], dt=DT).refined(4)
    here = engine.free_run(model, model.theta({"cubic_position__velocity": CUBIC}), series)
    y = there["simulation"]["series"][0]["y"]["y"]
    assert np.allclose(y, here.y[series.samples, 0], rtol=1e-9, atol=1e-12)

    one = job | {"model": reference | {"setting": setting | {"substeps": 1}}}
    _, coarse = run(client, ended, one)
    assert not np.allclose(coarse["simulation"]["series"][0]["y"]["y"], y, rtol=1e-6)

    wrong = {
        "kind": "simulate",
        "model": {"name": "linear-2", "with": ["force:z"], "setting": setting},
        "options": {"samples": 10},
    }
    answer = client.post("/jobs", json=wrong)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "model.setting.substeps"
