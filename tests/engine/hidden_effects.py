"""A small drive, and one case per kind of effect of the catalogue: where it is hidden, and how large."""

from dataclasses import replace

import numpy as np

import engine
from engine.diagnose.effects.hide import hide
from engine.diagnose.effects.spare_inputs import with_inputs

T = 400
DT = 0.1


def dynamics(a, u, t, dt, theta):
    f = [a[:, 0] + dt * (-theta.damping * a[:, 0] + u[0]), 0.0]
    A = [[dt * theta.load], [0.9]]
    return f, A, np.diag([2e-4, 1e-2])


def measurement(a, u, t, theta):
    return [a[:, 0]], [[0.0]], [[1e-3]]


def initial(theta):
    return engine.Gaussian([0.0], [[0.01]]), [0.0], [[0.05]]


DRIVE = engine.MixedModel(
    name="drive",
    dynamics=dynamics,
    measurement=measurement,
    initial=initial,
    nonlinear={"speed": "m/s"},
    linear={"load": "m/s^2"},
    inputs={"force": "m/s^2"},
    outputs={"reading": "m/s"},
    parameters=[
        engine.Parameter("damping", 1.0, "1/s", (0.0, 10.0)),
        engine.Parameter("load", 1.0, "1", (0.0, 5.0)),
    ],
)


def levels(rng, n=T):
    """A force that changes level every two seconds: speeds of both signs and many sizes."""
    return np.repeat(rng.uniform(-2.0, 2.0, -(-n // 20)), 20)[:n]


def smooth(rng, n=T):
    """A force that swings within a second: what happens between its samples matters."""
    window = np.hanning(9)
    return np.convolve(2.0 * rng.standard_normal(n + 8), window / 2.0, "same")[4:-4]


def hidden(effects, values, seed, n=T, force=levels):
    """A series of the drive with effects in it."""
    rng = np.random.default_rng(seed)
    return hide(DRIVE, effects, values, n, rng, u=force(rng, n), dt=DT).series


# kind -> (channel, the effect's own parameters)
CASES = {
    "force": ("speed", {"force_speed": 0.6}),
    "quadratic": ("speed", {"quadratic_speed": 0.2}),
    "cubic": ("speed", {"cubic_speed": -0.8}),
    "product": ("speed*force->speed", {"product_speed_force_speed": -0.5}),
    "drag": ("speed", {"drag_speed": 0.9}),
    "coulomb": ("speed", {"coulomb_speed": 0.4}),
    "stribeck": ("speed", {"stribeck_speed": 1.0, "stribeck_speed_width": 0.3}),
    "deadzone": ("speed", {"deadzone_speed": -2.0, "deadzone_speed_width": 0.3}),
    "saturation": ("speed", {"saturation_speed": -4.0, "saturation_speed_width": 1.0}),
    "linear": ("load", {"linear_load": 0.9}),
    "coupling": ("speed->load", {"coupling_speed_load": -1.0}),
    "pole": ("speed", {"pole_speed": 4.0, "pole_speed_time": 0.5}),
    "mode": ("speed", {"mode_speed": 3.0, "mode_speed_frequency": 0.4, "mode_speed_damping": 0.2}),
    "hysteresis": ("speed", {"hysteresis_speed": -4.0, "hysteresis_speed_width": 0.2}),
    "overflow": ("speed", {"overflow_speed": 4.0, "overflow_speed_limit": 0.5}),
    "boucwen": (
        "speed",
        {"boucwen_speed": -4.0, "boucwen_speed_width": 0.3, "boucwen_speed_delta": -0.8},
    ),
    "cogging": (
        "angle->speed",
        {
            "cogging_angle__speed": 0.4,
            "cogging_angle__speed_period": 0.25,
            "cogging_angle__speed_offset": 0.05,
        },
    ),
    "bias": ("reading", {"bias_reading": 0.5}),
    "offset": ("reading", {"bias_reading": 0.5}),
    "drift": ("reading", {"drift_reading": 0.015}),
    "gain": ("reading", {"gain_reading": 0.5}),
    "lag": ("reading", {"lag_reading": 0.6}),
    "delay": ("reading", {"delay_reading": 3.0, "delay_reading_samples": 3.0}),
    "slow-sensor": ("reading", {"slow_sensor_reading": 0.3}),
    "input-coulomb": ("speed->force", {"input_coulomb_speed__force": 0.4}),
    "input-drag": ("speed->force", {"input_drag_speed__force": 0.9}),
    "slow-input": ("force", {"slow_input_force": 0.3}),
    "play": ("force", {"play_force": 0.4}),
    "cubic-sensor": ("reading", {"cubic_sensor_reading": 0.2}),
    "saturation-sensor": (
        "reading",
        {"saturation_sensor_reading": 0.8, "saturation_sensor_reading_limit": 0.8},
    ),
    "rectification": ("reading", {"rectification_reading": 0.3}),
    "quantisation": ("reading", {"quantisation_reading": 0.15**2 / 12.0}),
    "level": ("reading", {"level_reading": 0.4}),
    "variance": ("reading->speed", {"variance_reading_speed": 2.0}),
    "relative-noise": ("reading", {"relative_noise_reading": 0.01}),
    "correlation": ("speed,load", {"correlation_speed_load": 0.9}),
    # neither as quick as white noise nor as slow as the speed's answer to its own
    "colored": ("reading", {"colored_reading": 0.01, "colored_reading_time": 0.12}),
    "latent": (
        "speed,oscillating",
        {
            "latent_speed_oscillating": 0.1,
            "latent_speed_oscillating_time": 2.0,
            "latent_speed_oscillating_frequency": 1.0,
        },
    ),
    "heavy-tails": (
        "reading",
        {"heavy_tails_reading_share": 0.05, "heavy_tails_reading_ratio": 8.0},
    ),
    "input-offset": ("force", {"input_offset_force": 0.6}),
    "input-gain": ("force", {"input_gain_force": 0.5}),
    "input-deadzone": ("force", {"input_deadzone_force": 0.5}),
    "input-saturation": (
        "force",
        {"input_saturation_force": 1.0, "input_saturation_force_limit": 1.0},
    ),
    "hold": ("force", {"hold_force": 1.0}),
    "direct": ("force->reading", {"direct_force__reading": 0.1}),
    "path": ("force->speed", {"path_force__speed": 3.0, "path_force__speed_time": 0.5}),
    "extra-input": ("temperature->speed", {"extra_input_temperature_speed": 0.3}),
    "step": ("reading", {"step_reading": 0.4, "step_reading_time": 16.0}),
    "pulse": (
        "reading",
        {"pulse_reading": 0.5, "pulse_reading_time": 16.0, "pulse_reading_width": 0.1},
    ),
    "episode": (
        "reading",
        {"episode_reading": 0.3, "episode_reading_time": 16.0, "episode_reading_end": 17.5},
    ),
    "ramp": ("speed", {"ramp_speed": 0.05}),
    "harmonic": ("speed", {"harmonic_speed": 0.4, "harmonic_speed_frequency": 0.83}),
    "input-gain-step": (
        "force",
        {"input_gain_step_force": -0.5, "input_gain_step_force_time": 22.0},
    ),
    "gain-step": ("reading", {"gain_step_reading": 0.5, "gain_step_reading_time": 22.0}),
    "parameter-step": (
        "damping",
        {"parameter_step_damping": 1.0, "parameter_step_damping_time": 16.0},
    ),
    "parameter-episode": (
        "damping",
        {
            "parameter_episode_damping": 2.0,
            "parameter_episode_damping_time": 16.0,
            "parameter_episode_damping_end": 21.0,
        },
    ),
    "parameter-drift": ("damping", {"parameter_drift_damping": 1.2}),
    "parameter-slope": ("force->damping", {"parameter_slope_force__damping": 0.5}),
    "parameter-bend": ("damping", {"parameter_bend_damping": 0.4}),
    "bend": ("reading", {"bend_reading": 0.4}),
    "time-step": ("dt", {"time_step_dt": 1.3}),
    "held": ("load", {"held_load": 0.4}),
    "start": ("speed", {"start_speed": 2.0}),
    "start-scatter": ("speed", {"start_scatter_speed": -2.0}),
}


def swinging(a, u, t, dt, theta):
    """A pendulum by Euler's method; the drive's own dt is none: its load decays by the step."""
    f = [
        a[:, 0] + dt * (-theta.damping * a[:, 0] - 4.0 * np.sin(a[:, 1]) + u[0]),
        a[:, 1] + dt * a[:, 0],
    ]
    return f, np.zeros((2, 0)), dt * np.diag([1e-3, 1e-5])


SWING = engine.MixedModel(
    name="swing",
    dynamics=swinging,
    measurement=lambda a, u, t, theta: ([a[:, 1]], np.zeros((1, 0)), [[1e-4]]),
    initial=lambda theta: (engine.Gaussian([0.0, 0.0], 0.01 * np.eye(2)), [], np.zeros((0, 0))),
    nonlinear={"speed": "rad/s", "angle": "rad"},
    kinematic=("angle",),
    inputs={"force": "1/s^2"},
    outputs={"reading": "rad"},
    parameters=[engine.Parameter("damping", 0.8, "1/s", (0.0, 10.0))],
)


ON_SWING = {"time-step", "cogging"}  # kinds that need a real time step, or a position
OF_RECORDS = {"start-scatter"}  # kinds that several records tell, see test_start_scatter
SEVERAL_MASSES = {
    "input-coulomb",
    "input-drag",
}  # kinds that are asked where an input moves several

# by a sensor a hundred times as precise, through which one sees how its noises go together
PRECISE = replace(DRIVE, measurement=lambda a, u, t, theta: ([a[:, 0]], [[0.0]], [[1e-5]]))


def case(kind, seed):
    """(model, series, name) of a kind's case; extra channels are inputs of the model already."""
    channel, values = CASES[kind]
    name = f"{kind}:{channel}"
    if kind in ON_SWING:
        rng = np.random.default_rng(seed)
        return SWING, hide(SWING, [name], values, T, rng, u=levels(rng), dt=DT).series, name
    if kind == "correlation":
        rng = np.random.default_rng(seed)
        return PRECISE, hide(PRECISE, [name], values, T, rng, u=levels(rng), dt=DT).series, name
    if kind != "extra-input":
        force = smooth if kind == "hold" else levels
        return DRIVE, hidden([name], values, seed, T, force), name
    rng = np.random.default_rng(seed)
    force = levels(rng)
    warm = np.convolve(rng.standard_normal(T + 40), np.ones(41) / np.sqrt(41.0), "valid")
    both = np.column_stack([force, warm])
    y = hide(DRIVE, [name], values, T, rng, u=both, dt=DT).y
    series = engine.Series(y, force, dt=DT, extra=warm, extra_names=["temperature"])
    return with_inputs(DRIVE, ["temperature"]), series.with_extra_inputs(), name
