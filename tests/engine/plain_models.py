"""Models as a user writes them, in plain NumPy, and any of them in other units."""

from dataclasses import replace

import numpy as np

import engine


def room(continuous=False):
    """A room with a heater, in degC: temperature nonlinear, that of the wall linear."""

    def dynamics(a, u, t, dt, th):
        T = a[:, 0]
        f = [T + dt * (th.loss * (u[1] - T) - th.wall * T + th.heat * u[0]), dt * 0.1 * th.wall * T]
        A = [[dt * th.wall], [1.0 - dt * 0.1 * th.wall]]
        return f, A, dt * np.diag([4e-3, 1e-3])

    def measurement(a, u, t, th):
        return [a[:, 0]], [[0.0]], [[4e-2]]

    def initial(th):
        return engine.Gaussian([20.0], [[1.0]]), [19.0], [[0.5]]

    return engine.MixedModel(
        name="room",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"air": "degC"},
        linear={"masonry": "degC"},
        inputs={"heater": "W", "outside": "degC"},
        outputs={"y": "degC"},
        parameters=[
            engine.Parameter("loss", 0.1, "1/s", (0.0, 10.0)),
            engine.Parameter("wall", 0.2, "1/s", (0.0, 10.0)),
            engine.Parameter("heat", 0.5, "degC/s/W", (0.0, 10.0)),
        ],
        continuous=continuous,
    )


def pendulum(continuous=False):
    """A pendulum stepped by the second-order midpoint rule; its angle is measured."""

    def rates(angle, rate, u, th):
        return rate, -th.stiffness * np.sin(angle) - th.damping * rate + th.torque * u

    def dynamics(a, u, t, dt, th):
        q, v = a.T
        dq, dv = rates(q, v, u[0], th)
        dq, dv = rates(q + 0.5 * dt * dq, v + 0.5 * dt * dv, u[0], th)
        return (
            np.stack([q + dt * dq, v + dt * dv], axis=1),
            np.zeros((2, 0)),
            dt * np.diag([1e-6, 1e-2]),
        )

    def measurement(a, u, t, th):
        return [a[:, 0]], np.zeros((1, 0)), [[4e-4]]

    def initial(th):
        return engine.Gaussian([0.2, 0.0], np.diag([0.04, 0.04])), [], np.zeros((0, 0))

    return engine.MixedModel(
        name="pendulum",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"angle": "rad", "rate": "rad/s"},
        kinematic=("angle",),
        inputs={"motor": "V"},
        outputs={"y": "rad"},
        parameters=[
            engine.Parameter("stiffness", 9.0, "1/s^2", (0.1, 100.0)),
            engine.Parameter("damping", 0.3, "1/s", (0.0, 10.0)),
            engine.Parameter("torque", 4.0, "1/s^2/V", (0.0, 50.0)),
        ],
        continuous=continuous,
    )


def tank():
    """A tank that empties by Bernoulli's law; its pump and its level are known."""

    def dynamics(a, u, t, dt, th):
        level = a[:, 0]
        f = level + dt * (th.pump * u[0] - th.outlet * np.sqrt(np.maximum(level, 0.0)))
        return f[:, None], np.zeros((1, 0)), [[dt * 1e-3]]

    def measurement(a, u, t, th):
        return [a[:, 0]], np.zeros((1, 0)), [[1e-3]]

    def initial(th):
        return engine.Gaussian([3.0], [[0.2]]), [], np.zeros((0, 0))

    return engine.MixedModel(
        name="tank",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        nonlinear={"level": "m"},
        inputs={"pump": "V"},
        outputs={"y": "m"},
        parameters=[
            engine.Parameter("pump", 0.4, "m/s/V", (0.0, 10.0)),
            engine.Parameter("outlet", 0.5, "m^0.5/s", (0.0, 10.0)),
        ],
    )


def cart(pull=0.0, reading=lambda x: x, rough=0.0):
    """A cart on a rail, seen by a tape measure; ``pull`` of a spring to the middle in 1/s^2.

    The variance of a reading may grow with the square of the position, by a share ``rough`` per m^2.
    """

    def dynamics(a, u, t, dt, th):
        x, v = a[:, 0], a[:, 1]
        v = v + dt * (th.b * u[0] - th.c * v - pull * x)
        return [x + dt * v, v], np.zeros((2, 0)), [[1e-8, 0.0], [0.0, dt * 0.05**2]]

    return engine.MixedModel(
        name="cart",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: (
            [reading(a[:, 0])],
            np.zeros((1, 0)),
            [[th.r**2 * (1.0 + rough * a[:, 0] ** 2)]],
        ),
        initial=lambda th: (engine.Gaussian([0.0, 0.0], 0.01 * np.eye(2)), [], np.zeros((0, 0))),
        nonlinear={"position": "m", "speed": "m/s"},
        inputs={"force": "N"},
        outputs={"tape": "m"},
        parameters=[
            engine.Parameter("b", 1.0, "1/kg", (0.01, 10.0)),
            engine.Parameter("c", 0.5, "1/s", (0.0, 5.0)),
            engine.Parameter("r", 0.02, "m", (1e-4, 1.0)),
        ],
    )


def mixer():
    """Two stirred tanks in a row; nothing in the equations knows where concentrations count from."""

    def dynamics(a, u, t, dt, th):
        A = [[1.0 - dt * th.d1, 0.0], [dt * th.d2, 1.0 - dt * th.d2]]
        return [dt * th.d1 * u[0], 0.0], A, dt * th.q * np.eye(2)

    return engine.MixedModel(
        name="mixer",
        dynamics=dynamics,
        measurement=lambda a, u, t, th: ([0.0], [[0.0, 1.0]], [[th.r**2]]),
        initial=lambda th: (engine.Gaussian([], np.zeros((0, 0))), [5.0, 5.0], np.eye(2)),
        nonlinear={},
        linear={"first": "g/L", "second": "g/L"},
        inputs={"feed": "g/L"},
        outputs={"probe": "g/L"},
        parameters=[
            engine.Parameter("d1", 0.1, "1/s", (1e-3, 1.0)),
            engine.Parameter("d2", 0.06, "1/s", (1e-3, 1.0)),
            engine.Parameter("q", 1e-4, "", (1e-9, 1.0)),
            engine.Parameter("r", 0.05, "g/L", (1e-4, 1.0)),
        ],
    )


def oven():
    """A heated body whose state is linear, of differential equations."""
    return engine.continuous(
        name="oven",
        drift=lambda a, u, t, th: ([th.k * u[0]], [[-1.0 / th.tau]]),
        diffusion=lambda a, u, t, th: [[th.q]],
        measurement=lambda a, u, t, th: ([0.0], [[1.0]], [[th.r]]),
        initial=lambda th: (None, [0.0], [[1e-2]]),
        linear={"above": "K"},
        inputs={"heater": "W"},
        outputs={"reading": "K"},
        parameters=[
            engine.Parameter("tau", 20.0, "s", (1.0, 500.0)),
            engine.Parameter("k", 0.1, "K/s/W", (0.0, 10.0)),
            engine.Parameter("q", 1e-2, "K^2/s", (1e-8, 10.0)),
            engine.Parameter("r", 0.01, "K^2", (1e-6, 10.0)),
        ],
    )


def record(model, n=120, seed=1, dt=0.1):
    """A clean series of one of these, driven by levels that are held for a while."""
    rng = np.random.default_rng(seed)
    low, high = {
        "room": (0.0, 8.0),
        "pendulum": (-1.5, 1.5),
        "tank": (1.0, 3.5),
        "cart": (-1.0, 1.0),
    }[model.name]
    u = np.repeat(rng.uniform(low, high, -(-n // 10)), 10)[:n]
    if model.nu == 2:
        u = np.column_stack([u, 5.0 + np.cumsum(0.2 * rng.standard_normal(n))])
    return engine.simulate(model, None, n, rng, u=u, dt=dt).series


class Units:
    """Other units: channel -> (factor, offset), x_new = factor x + offset; times likewise."""

    def __init__(self, model, channels=None, time=(1.0, 0.0)):
        self.model, self.time = model, time
        names = {**model.nonlinear, **model.linear, **model.inputs, **model.outputs}
        self.channels = dict.fromkeys(names, (1.0, 0.0)) | dict(channels or {})

    def of(self, names):
        pairs = np.array([self.channels[name] for name in names]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def series(self, one):
        (cu, du), (cy, dy) = self.of(self.model.inputs), self.of(self.model.outputs)
        t = self.time[0] * one.t + self.time[1]
        return engine.Series(one.y * cy + dy, one.u * cu + du, t=t)

    def converted(self):
        """The same model in these units; parameters keep theirs."""
        model = self.model
        ca, da = self.of(model.nonlinear)
        cz, dz = self.of(model.linear)
        cu, du = self.of(model.inputs)
        cy, dy = self.of(model.outputs)
        cx, dx = np.concatenate([ca, cz]), np.concatenate([da, dz])
        (s, t0), zero = self.time, dz / cz

        def back(a, u, t):
            u = np.asarray(u, dtype=float)
            wide = (slice(None),) + (None,) * (u.ndim - 1)
            return (a - da) / ca, (u - du[wide]) / cu[wide], (t - t0) / s

        def dynamics(a, u, t, dt, th):
            f, A, Q = model.transition(*back(a, u, t), dt / s, th)
            f = cx * (f - np.einsum("...ij,j->...i", A, zero)) + dx
            return f, A * (cx[:, None] / cz), Q * np.outer(cx, cx)

        def measurement(a, u, t, th):
            h, C, R = model.observation(*back(a, u, t), th)
            h = cy * (h - np.einsum("...ij,j->...i", C, zero)) + dy
            return h, C * (cy[:, None] / cz), R * np.outer(cy, cy)

        def initial(th):
            density, z1, P1 = model.initial(th)
            first = engine.Gaussian(density.mean * ca + da, density.cov * np.outer(ca, ca))
            return first, np.asarray(z1) * cz + dz, np.asarray(P1) * np.outer(cz, cz)

        reference = {
            n: self.channels[n][0] * v + self.channels[n][1] for n, v in model.reference.items()
        }
        return replace(
            model,
            dynamics=dynamics,
            measurement=measurement,
            initial=initial,
            reference=reference,
        )


def referred(model, values=None):
    """The model with the zero of every channel declared."""
    names = [*model.nonlinear, *model.linear, *model.inputs, *model.outputs]
    return replace(model, reference=dict.fromkeys(names, 0.0) | dict(values or {}))


def heated(second):
    """A room beside its wall as differential equations, in a unit of time that is 1 / ``second`` seconds."""

    def drift(a, u, t, th):
        f = np.tile([th.h * u[0] / second, 0.0], (len(a), 1))
        return f, np.array([[-th.c, th.c], [0.1 * th.c, -0.1 * th.c]]) / second

    return engine.continuous(
        name="heated",
        drift=drift,
        diffusion=lambda a, u, t, th: np.diag([1e-6, 1e-8]) / second,
        measurement=lambda a, u, t, th: (np.zeros((len(a), 1)), [[1.0, 0.0]], [[0.01]]),
        initial=lambda th: (engine.Gaussian([], np.zeros((0, 0))), [20.0, 18.0], np.eye(2)),
        linear={"air": "degC", "wall": "degC"},
        inputs={"heater": "kW"},
        outputs={"thermometer": "degC"},
        parameters=[engine.Parameter("c", 1e-4), engine.Parameter("h", 2e-3)],
    )


def absorption():
    """A drug's way through gut and blood: the two rates may change places, and the volume with them."""

    def dynamics(a, u, t, dt, th):
        gone, cleared = np.exp(-th.ka * dt), np.exp(-th.ke * dt)
        taken = th.ka * (gone - cleared) / (th.ke - th.ka)
        return [0.0, 0.0], [[gone, 0.0], [taken, cleared]], np.diag([1e-6, 1e-4])

    def measurement(a, u, t, th):
        return [0.0], [[0.0, 1.0 / th.V]], [[1e-2]]

    def initial(th):
        return None, [100.0, 0.0], np.zeros((2, 2))

    return engine.MixedModel(
        name="absorption",
        dynamics=dynamics,
        measurement=measurement,
        initial=initial,
        linear={"gut": "mg", "blood": "mg"},
        outputs={"concentration": "mg/L"},
        parameters=[
            engine.Parameter("ka", 1.5, "1/s", (0.01, 10.0)),
            engine.Parameter("ke", 0.3, "1/s", (0.01, 10.0)),
            engine.Parameter("V", 20.0, "L", (1.0, 500.0)),
        ],
    )


def dose(k=0.6, r=1e-3):
    """A drug that leaves the blood; how far apart persons begin is a parameter."""
    own = engine.Parameter
    return engine.continuous(
        name="dose",
        drift=lambda a, u, t, theta: ([0.0], [[-theta.k]]),
        diffusion=lambda a, u, t, theta: [[theta.q]],
        measurement=lambda a, u, t, theta: ([0.0], [[1.0]], [[theta.r]]),
        initial=lambda theta: (None, [theta.c0], [[theta.s0**2]]),
        nonlinear={},
        linear={"conc": "mg/L"},
        outputs={"y": "mg/L"},
        parameters=[
            own("k", k, "1/h", (0.01, 10.0)),
            own("c0", 2.0, "mg/L", (0.1, 20.0)),
            own("s0", 0.4, "mg/L", (1e-3, 5.0)),
            own("q", 1e-4, "(mg/L)^2/h", (1e-8, 1.0)),
            own("r", r, "(mg/L)^2", (1e-8, 1.0)),
        ],
    )
