"""A model of your own: a pendulum driven by a torque, to be changed into yours.

What the equation says, with x = (angle, rate), g/l = w2 and a torque u:

    angle' = rate
    rate'  = -w2 sin(angle) - d rate + u

Try it:

    python NAME.py                    simulates a record and finds its parameters again
    rbps models NAME.py               shows it and says what the check of its functions says
    rbps fit data.csv -m NAME.py --method simulation
    rbps diagnose data.csv -m NAME.py --report report.html
    rbps serve --model NAME.py        has it on the pages
"""

import numpy as np

import engine


def drift(a, u, t, theta):
    """The right-hand side f + A z, each state's unit per second.

    States that enter nonlinearly are columns of a, which has a row for each particle: a[:, 0], never a[0];
    np.where(condition, x, y), never if. States that enter linearly are in z and only have columns in A.
    """
    angle = a[:, 0]
    # for each state, what does not hold the rate
    f = [0.0, -theta.w2 * np.sin(angle) + u[0]]
    # what multiplies the rate: a row for each state, a column for each of z
    A = [[1.0], [-theta.d]]
    return f, A


def diffusion(a, u, t, theta):
    """What the equations leave out, as white noise: its variance per second for each state.

    Rather too much than none: without any, the filter believes the model before the data.
    """
    return [[0.0, 0.0], [0.0, theta.q]]


def measurement(a, u, t, theta):
    """What the sensors read: y = h + C z + e, and the variance R of e, which must not be zero."""
    return [a[:, 0]], [[0.0]], [[theta.r]]


def initial(theta):
    """Where it begins: mean and covariance of a, then of z; as far off as you may be."""
    return engine.Gaussian([0.0], [[0.3**2]]), [0.0], [[0.5**2]]


model = engine.continuous(
    name="NAME",
    description="Pendulum driven by a torque; replace this by what yours is.",
    equations=["angle' = rate", "rate' = -w2 sin(angle) - d rate + torque + w", "y = angle + e"],
    drift=drift,
    diffusion=diffusion,
    measurement=measurement,
    initial=initial,
    nonlinear={"angle": "rad"},  # columns of a: name and unit
    linear={"rate": "rad/s"},  # rows of z; kinematic says that angle' = rate holds by definition
    kinematic=["angle"],
    inputs={"torque": "1/s^2"},  # u, in this order; {} for none
    outputs={"y": "rad"},
    parameters=[  # name, start value, unit, bounds, meaning; those that are known are held with --fix
        engine.Parameter("w2", 30.0, "1/s^2", (1.0, 200.0), "gravity over length"),
        engine.Parameter("d", 0.5, "1/s", (0.0, 10.0), "damping"),
        engine.Parameter("q", 0.01, "(rad/s)^2/s", (1e-8, 10.0), "noise of the rate, per second"),
        engine.Parameter("r", 1e-4, "rad^2", (1e-8, 1.0), "variance of a reading"),
    ],
)


if __name__ == "__main__":
    rng = np.random.default_rng(1)
    torque = np.repeat(rng.uniform(-8.0, 8.0, 20), 25)  # a new level each half second
    truth = {"w2": 40.0, "d": 0.8}
    series = engine.simulate(model, truth, 500, rng, u=torque, dt=0.02).series
    print(f"simulated with {truth}; found again from {model.theta().asdict()}:")
    print(engine.fit_simulation(model, series))
