"""The shipped models: registered, evaluated per step and stacked alike; servo's and tanks' physics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import engine.models.registry as registry
from engine.models import servo, tanks


def evaluate(model, a, u, t, dt):
    theta = model.record(model.theta())
    return (
        *model.transition(a, u, t, dt, theta),
        *model.observation(a, u, t, theta),
    )


def full(value, K, i):
    """Row i of what may be common to all K rows; f and h always have rows."""
    return value[i] if value.shape[0] == K and value.ndim > 1 else value


@pytest.mark.parametrize(
    "name", ["linear-2", "mixed-4", "local-level", "oscillator", "servo", "tanks"]
)
@pytest.mark.parametrize("irregular", [False, True])
def test_stacked_steps_are_the_steps_one_by_one(name, irregular):
    model = registry.get_model(name)
    rng, K = np.random.default_rng(1), 17
    theta = model.record(model.theta())
    a = model.start(theta).density.sample(rng, K)
    u, t = rng.standard_normal((K, model.nu)), np.arange(K) * 0.02
    dt = rng.uniform(0.01, 0.03, K) if irregular else np.full(K, 0.02)
    stacked = evaluate(model, a, u.T, t, dt)
    for i in range(K):
        one = evaluate(model, a[i : i + 1], u[i], float(t[i]), float(dt[i]))
        for together, alone in zip(stacked, one, strict=True):
            expected = alone[0] if alone.ndim == 3 or alone.shape[0] == 1 else alone
            got = full(together, K, i)
            np.testing.assert_allclose(got.ravel(), expected.ravel(), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("name", ["oscillator", "servo", "tanks"])
def test_every_parameter_is_described(name):
    for parameter in registry.get_model(name).parameters:
        assert parameter.unit
        assert parameter.description
        assert np.isfinite(parameter.bounds).all()


# ---- moments over one step against a fine Euler-Maruyama simulation -------------------------


def test_servo_moments_against_fine_simulation():
    model = servo.MODEL
    theta = model.theta({"sigma_v": 0.05, "sigma_load": 40.0})
    p, dt, n, fine = model.record(theta), 0.1, 20_000, 400
    v0, z0, u = 0.2, np.array([0.1, 4.0]), 1.5
    rng, h = np.random.default_rng(2), dt / fine
    v, q, d = np.full(n, v0), np.full(n, z0[0]), np.full(n, z0[1])
    for _ in range(fine):  # v stays positive, so friction is constant over the step
        force = p.gtau * u - p.Fv * v - p.Fc - p.offset - d
        w = rng.standard_normal((2, n)) * np.sqrt(h)
        v, q, d = v + h * force / p.M + p.sigma_v * w[0], q + h * v, d + p.sigma_load * w[1]
    f, A, Q = model.transition(np.array([[v0]]), np.array([u]), 0.0, dt, p)
    x = np.stack((v, q, d))
    sd = np.sqrt(np.diag(Q))
    # The mean is off by the Euler step (relative 1/400) and by 4 standard errors at most.
    np.testing.assert_allclose(
        (x.mean(axis=1) - (f[0] + A @ z0)) / sd, 0.0, atol=4 / np.sqrt(n) + 0.02
    )
    correlation = np.cov(x) / np.outer(sd, sd)
    np.testing.assert_allclose(correlation, Q / np.outer(sd, sd), atol=0.05)
    assert abs(Q[0, 1]) > 0.5 * sd[0] * sd[1]  # Q_az is far from zero


def test_tanks_moments_against_fine_simulation():
    model = tanks.MODEL
    theta = model.theta({"sigma_level": 0.01, "sigma_inflow": 2e-4})
    p, dt, n, fine = model.record(theta), 4.0, 20_000, 200
    a0, z0, u = np.array([9.0, 4.0]), np.array([0.005]), 2.5
    rng, h = np.random.default_rng(3), dt / fine
    x1, x2, d = np.full(n, a0[0]), np.full(n, a0[1]), np.full(n, z0[0])
    for _ in range(fine):
        w = rng.standard_normal((3, n)) * np.sqrt(h)
        through = p.k1 * np.sqrt(x1)
        x1, x2, d = (
            x1 + h * (p.k4 * u - through + d) + p.sigma_level * w[0],
            x2 + h * (through - p.k3 * np.sqrt(x2)) + p.sigma_level * w[1],
            d + p.sigma_inflow * w[2],
        )
    f, A, Q = model.transition(a0[None], np.array([u]), 0.0, dt, p)
    x, sd = np.stack((x1, x2, d)), np.sqrt(np.diag(Q))
    np.testing.assert_allclose((x.mean(axis=1) - (f[0] + A @ z0)) / sd, 0.0, atol=0.04)
    # The model lets no noise drain within the step: dt k / (2 sqrt x) = 9 % of the variance here.
    np.testing.assert_allclose(np.cov(x) / np.outer(sd, sd), Q / np.outer(sd, sd), atol=0.11)


def test_tanks_flow_against_an_ode_solver():
    p = tanks.MODEL.record(tanks.MODEL.theta())

    def flow(t, x):
        through = p.k1 * np.sqrt(max(x[0], 0.0))
        return [p.k4 * 3.0 - through, through - p.k3 * np.sqrt(max(x[1], 0.0))]

    for a in ([10.0, 5.0], [2.0, 9.0], [15.0, 3.0]):
        f, _, _ = tanks.MODEL.transition(np.array([a]), np.array([3.0]), 0.0, 4.0, p)
        exact = solve_ivp(flow, (0.0, 4.0), a, rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(f[0, :2], exact, atol=2e-3 * np.abs(exact - a).max())
    f, _, _ = tanks.MODEL.transition(np.array([[-0.5, 0.0]]), np.array([0.0]), 0.0, 4.0, p)
    np.testing.assert_array_equal(f[0], [-0.5, 0.0, 0.0])  # an empty tank has no outflow


# ---- friction -------------------------------------------------------------------------------


def run_servo(v, u, dt, steps, **theta):
    model = servo.MODEL
    p, a, z, out = model.record(model.theta(theta)), np.array([[v]]), np.zeros((1, 2)), [v]
    for _ in range(steps):
        f, A, _ = model.transition(a, np.array([u]), 0.0, dt, p)
        x = f + z @ A.T
        a, z = x[:, :1], x[:, 1:]
        out.append(float(a[0, 0]))
    return np.array(out), z[0]


@pytest.mark.parametrize("dt", [1e-3, 5e-3, 20e-3])
def test_friction_stops_and_never_reverses(dt):
    v, z = run_servo(0.1, 0.0, dt, round(2.0 / dt), Fc=20.0, offset=0.0)
    assert (v >= 0.0).all()
    assert (np.diff(v) <= 0.0).all()
    assert v[-1] == 0.0
    # M v' = -Fv v - Fc from v_0 = 0.1 m/s: the way until it stands, in closed form.
    tau = 95.0 / 203.0
    stop = tau * np.log1p(203.0 * 0.1 / 20.0)
    exact = (0.1 + 20.0 / 203.0) * tau * (1 - np.exp(-stop / tau)) - 20.0 / 203.0 * stop
    assert z[0] == pytest.approx(exact, rel=1e-9)


def test_standing_drive_holds_against_less_than_coulomb_and_gives_way_to_more():
    held, _ = run_servo(0.0, 0.5, 1e-2, 100, gtau=35.0, offset=0.0, Fc=20.0)  # 17.5 N
    np.testing.assert_array_equal(held, 0.0)
    free, _ = run_servo(0.0, 0.6, 1e-2, 2000, gtau=35.0, offset=0.0, Fc=20.0)  # 21 N
    assert free[-1] == pytest.approx((21.0 - 20.0) / 203.0, rel=1e-6)


@pytest.mark.parametrize("v", [-0.3, -2e-3, 0.0, 5e-4, 0.1])
@pytest.mark.parametrize("u", [-1.5, -0.4, 0.0, 0.6])  # -52.7 N; what friction holds; 21 N
@pytest.mark.parametrize("Fv", [0.0, 203.0])
def test_one_step_in_which_the_drive_stops_or_turns_is_many_short_ones(v, u, Fv):
    coarse, z_coarse = run_servo(v, u, 0.1, 1, Fv=Fv, offset=0.0)
    fine, z_fine = run_servo(v, u, 1e-3, 100, Fv=Fv, offset=0.0)
    assert coarse[-1] == pytest.approx(fine[-1], abs=1e-12)
    np.testing.assert_allclose(z_coarse, z_fine, atol=1e-12)
    short = 1e-5  # and these are Coulomb's law: friction takes at most what there is of the speed
    x = 0.0
    for _ in range(10_000):
        pushed = v + short * (35.15 * u - Fv * v) / 95.0
        after = np.sign(pushed) * max(abs(pushed) - short * 20.0 / 95.0, 0.0)
        x, v = x + short * 0.5 * (v + after), after
    assert coarse[-1] == pytest.approx(v, abs=1e-5)
    assert z_coarse[0] == pytest.approx(x, abs=1e-6)


def test_servo_without_friction_is_exact_for_any_step():
    coarse, z_coarse = run_servo(0.2, 1.0, 0.5, 4, Fc=0.0)
    fine, z_fine = run_servo(0.2, 1.0, 0.001, 2000, Fc=0.0)
    assert coarse[-1] == pytest.approx(fine[-1], rel=1e-9)
    np.testing.assert_allclose(z_coarse, z_fine, rtol=1e-9)


def test_servo_without_viscous_friction():
    v, z = run_servo(0.0, 1.0, 0.1, 10, Fv=0.0, Fc=0.0, offset=0.0, gtau=95.0)
    assert v[-1] == pytest.approx(1.0)
    assert z[0] == pytest.approx(0.5)


# ---- oscillator ------------------------------------------------------------------------------


def test_oscillator_is_exact_for_any_step_and_rests_at_gain_times_input():
    model = registry.get_model("oscillator")
    theta = model.record(model.theta({"omega": 5.0, "zeta": 0.1, "gain": 2.0}))

    def run(dt, n):
        a, z = np.array([[0.3]]), np.array([[-1.0]])
        for _ in range(n):
            f, A, _ = model.transition(a, [0.7], 0.0, dt, theta)
            x = f + z @ A.T
            a, z = x[:, :1], x[:, 1:]
        return np.concatenate([a, z], axis=1)[0]

    np.testing.assert_allclose(run(0.5, 2), run(0.001, 1000), rtol=1e-9)
    damped = 5.0 * np.sqrt(1.0 - 0.1**2)
    x0, v0 = 0.3 - 1.4, -1.0  # about the rest position
    swing = x0 * np.cos(damped) + (v0 + 0.5 * x0) / damped * np.sin(damped)
    assert run(0.5, 2)[0] == pytest.approx(1.4 + np.exp(-0.5) * swing)
    assert run(0.5, 100)[0] == pytest.approx(1.4)


def test_oscillator_noise_grows_with_the_step_as_the_variances_say():
    model = registry.get_model("oscillator")
    theta = model.record(model.theta({"omega": 5.0, "zeta": 0.1, "sigma_v": 0.4}))
    a = np.zeros((1, 1))
    _, A, Q = model.transition(a, [0.0], 0.0, 50.0, theta)
    stationary = 0.4**2 / (4.0 * 0.1 * 5.0)  # velocity variance sigma^2 / (4 zeta omega)
    np.testing.assert_allclose(Q, [[stationary / 25.0, 0.0], [0.0, stationary]], atol=1e-9)
    np.testing.assert_allclose(A, 0.0, atol=1e-9)
