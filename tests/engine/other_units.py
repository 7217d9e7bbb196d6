"""A model and its series in other units: x' = D x, y' = E y, u' = G u, t' = s t, theta' = B theta."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from engine import Gaussian, MixedModel, Series


@dataclass(frozen=True)
class Units:
    """Factors of the states (nx,), outputs (ny,), inputs (nu,), of time, and of the parameters (n,)."""

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    t: float
    theta: np.ndarray

    @classmethod
    def of(cls, model: MixedModel, power) -> Units:
        """Powers of two, so that nothing is rounded; ``power()`` gives an exponent."""
        sizes = (model.nx, model.ny, model.nu, len(model.parameters))
        x, y, u, theta = (np.exp2([float(power()) for _ in range(n)]) for n in sizes)
        return cls(x, y, u, float(np.exp2(power())), theta)

    def model(self, model: MixedModel) -> MixedModel:
        """The same model, told in the new units."""
        na = model.na
        D, Da, Dz = self.x, self.x[:na], self.x[na:]

        def old(u):
            return (np.asarray(u).T / self.u).T if len(self.u) else u

        def values(theta):
            return model.record([v / b for v, b in zip(theta, self.theta, strict=True)])

        def dynamics(a, u, t, dt, theta):
            f, A, Q = model.transition(a / Da, old(u), t / self.t, dt / self.t, values(theta))
            return f * D, A * (D[:, None] / Dz), Q * np.outer(D, D)

        def measurement(a, u, t, theta):
            h, C, R = model.observation(a / Da, old(u), t / self.t, values(theta))
            return h * self.y, C * (self.y[:, None] / Dz), R * np.outer(self.y, self.y)

        def initial(theta):
            start = model.start(values(theta))
            p = start.density
            return (
                Gaussian(p.mean * Da, p.cov * np.outer(Da, Da)),
                lambda a: start.linear(a / Da)[0] * Dz,
                lambda a: start.linear(a / Da)[1] * np.outer(Dz, Dz),
            )

        parameters = [
            replace(p, default=p.default * b, bounds=(p.bounds[0] * b, p.bounds[1] * b))
            for p, b in zip(model.parameters, self.theta.tolist(), strict=True)
        ]
        return replace(
            model,
            dynamics=dynamics,
            measurement=measurement,
            initial=initial,
            parameters=parameters,
        )

    def series(self, series: Series) -> Series:
        """The same record."""
        u = series.u * self.u if series.u.shape[1] else None
        return Series(series.y * self.y, u, t=series.t * self.t)

    def log_jacobian(self, series: Series) -> float:
        """What a log-likelihood falls by."""
        return float((series.observed * np.log(self.y)).sum())
