"""Draws from a model, and the loop over time that every open-loop run shares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from engine.data.series import Series
from engine.errors import ModelError, OptionError
from engine.failing import where_it_fails
from engine.kernels.gaussian import psd_cholesky, psd_cholesky_many
from engine.randomness import Rng, generator
from engine.simulation.steps import observations
from engine.simulation.taped import run_by_tape
from engine.simulation.whole_record import whole_record
from engine.statespace.checks import FIRST_Z, READING, STEP, check_start, possible_noise
from engine.statespace.had import no_number
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.statespace.refutation import repeated_if_refuted
from engine.statespace.shapes import through
from engine.threads import single_threaded
from engine.units import SECOND
from engine.views import Figures, Shown, View, figures, plots


@dataclass(frozen=True, eq=False)
class Simulation(Shown):
    """A run of a model.

    Attributes
    ----------
    y : array (T, ny)
        Outputs, with the measurement noise in them.
    a : array (T, na)
        True nonlinear states.
    z : array (T, nz)
        True linear states.
    series : Series
        The outputs with the inputs and times they were made with.
    model : MixedModel
        The model that was simulated.
    """

    y: Array
    a: Array
    z: Array
    series: Series
    model: MixedModel

    def plot(self) -> Figures:
        """Draw the figures ``outputs`` and ``states`` over time; needs the extra ``plot``."""
        units = {**self.model.nonlinear, **self.model.linear}
        x = np.concatenate([self.a, self.z], axis=1)
        t, clock = self.series.t, self.series.time_unit
        return figures(
            outputs=plots().states(t, self.model.outputs, self.y, None, clock),
            states=plots().states(t, units, x, None, clock),
        )

    def _view(self) -> View:
        return self.series._view()


@single_threaded
def simulate(
    model: MixedModel,
    theta: ThetaLike,
    n_samples: int,
    rng: Rng,
    u: ArrayLike | None = None,
    dt: float | None = None,
    t: ArrayLike | None = None,
    hold: str = "zoh",
    time_unit: str = SECOND,
) -> Simulation:
    """Draw samples of paper, eq. (1): x_1 from the initial density, w and e with noise.

    Q and R may be singular.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    theta : Theta, mapping, array or None
        Parameters: all as (n_theta,), some by name, or None for the model's defaults.
    n_samples : int
        Number of samples T, at least 2.
    rng : numpy.random.Generator or int
        Source of all random numbers, or the seed of one.
    u : array (T, nu) or (T,), optional
        Inputs, in the units that the model declares; needed where it has inputs.
    dt : float, optional
        Time step in ``time_unit``, where ``t`` is not given; 1 by default.
    t : array (T,), optional
        Increasing times of the samples, in ``time_unit``.
    hold : str
        What inputs do between samples, see :class:`engine.Series`.
    time_unit : str
        What times count, see :class:`engine.Series`.

    Returns
    -------
    Simulation
        ``y`` (T, ny), the states behind it, and both with the inputs as a Series.

    Raises
    ------
    ModelError
        The state stopped being finite; names the time.
    OptionError
        Inputs are missing, or there are too few samples.
    """
    rng = generator(rng)
    if n_samples < 2:
        raise OptionError(f"n_samples = {n_samples}; at least 2 are needed", "n_samples")
    if u is None and model.nu:
        raise OptionError(
            f"model '{model.name}' has inputs ({', '.join(model.inputs)}); "
            f"pass u ({n_samples}, {model.nu})",
            "u",
        )
    blank = np.zeros((n_samples, model.ny))
    frame = Series(blank, u, dt=dt, t=t, hold=hold, time_unit=time_unit).check(model)
    y, a, z = copies(model, theta, frame, 1, rng)
    y, a, z = y[:, 0], a[:, 0], z[:, 0]
    series = frame.replace(y=y, y_names=tuple(model.outputs), u_names=tuple(model.inputs))
    return Simulation(y, a, z, series, model)


def copies(
    model: MixedModel, theta: ThetaLike, frame: Series, n: int, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """n records drawn at once over a series' inputs and times: y (T, n, ny), a (T, n, na), z (T, n, nz).

    Each has a first state and noise of its own. To draw many takes little longer than to draw one. Raises
    ModelError where one of them runs away.
    """
    values = model.theta(theta)
    check_start(model, values, frame)
    record = model.record(values)
    a1 = model.start(record).density.sample(rng, n)
    z1, P1 = model.start(record).linear(a1)
    z1 = z1 + noise(possible_noise(model, FIRST_Z, P1, frame.t[0]), z1.shape, rng)
    y, a, z = propagate(model, record, frame, a1, z1, rng)
    check_finite(model, record, frame, y, a, z)
    return y, a, z


@repeated_if_refuted
def propagate(
    model: MixedModel,
    record: Any,
    series: Series,
    a: Array,
    z: Array,
    rng: np.random.Generator | None = None,
    process: bool = True,
    measurement: bool = True,
) -> tuple[Array, Array, Array]:
    """Run K copies of a model over a series' inputs and times: y (T, K, ny), a (T, K, na), z.

    ``a`` (K, na), ``z`` (K, nz) are the first states. Without ``rng`` the run is noise-free; with
    it, process and measurement noise are drawn where asked for. The record's fields are numbers,
    or arrays (K,), see ``model.records``. What overflows is left as inf or NaN. A single long run without
    process noise is found as a whole where that is faster, see :mod:`engine.simulation.whole_record`.
    """
    noisy = rng is not None and process
    single = len(a) == 1 and all(value.__class__ is float for value in record)
    if not single or rng is not None:  # of others some rows are calculated alone
        model.transitions.look_again(series.u_step)
        model.observations.look_again(series.u)
    with np.errstate(all="ignore"):
        x1, alone = np.concatenate((a, z), axis=1), single and not noisy
        a_all, z_all = _states(model, record, series, x1, alone, rng if noisy else None)
        noisy_y = rng if measurement else None
        y = _outputs(model, record, series, a_all, z_all, noisy_y)
        if single and noisy_y is None:
            x = np.concatenate((a_all[:, 0], z_all[:, 0]), axis=1)
            if not observations(model, record, series).as_alone(x, y[:, 0]):
                model.observations.look_again()
                y = _outputs(model, record, series, a_all, z_all, None)
    return y, a_all, z_all


@repeated_if_refuted
def states_of(
    model: MixedModel, record: Any, series: Series, x1: Array, guess: Array | None = None
) -> Array:
    """The states (T, nx) of one noise-free run from x1 (nx,), as of :func:`propagate`.

    ``guess`` (T, nx) is a run nearby, such as that of the model without an effect: it spares the loop over
    time where Newton's method would not find the run from x1 alone.
    """
    with np.errstate(all="ignore"):
        a, z = _states(model, record, series, x1[None], True, guess=guess)
    return np.concatenate((a[:, 0], z[:, 0]), axis=1)


def _states(
    model: MixedModel,
    record: Any,
    series: Series,
    x1: Array,
    alone: bool,
    rng: np.random.Generator | None = None,
    guess: Array | None = None,
) -> tuple[Array, Array]:
    """States a (T, K, na), z (T, K, nz) from x1 (K, nx), with noise where ``rng`` is given.

    Without noise they are found in one call where the step is on tape; else a run ``alone`` is found as a
    whole as far as that goes, the rest by a loop over time.
    """
    na, inputs = model.na, series.u_step
    lengths = step_lengths(series)
    if rng is None:
        taped = run_by_tape(model, record, series, x1, lengths)
        if taped is not None:
            return taped[..., :na], taped[..., na:]
    known = whole_record(model, record, series, x1[0], guess)[:, None] if alone else x1[None]
    a_all, z_all = (np.empty((len(series), len(x1), n)) for n in (na, model.nz))
    a_all[: len(known)], z_all[: len(known)] = known[..., :na], known[..., na:]
    if len(known) == len(series):
        return a_all, z_all
    steps, times = lengths.tolist(), series.t.tolist()
    for t in range(len(known) - 1, len(series) - 1):
        f, A, Q = model.transition(a_all[t], inputs[t], times[t], steps[t], record)
        x = f + through(A, z_all[t])
        if rng is not None:
            x += noise(possible_noise(model, STEP, Q, times[t]), x.shape, rng)
        a_all[t + 1], z_all[t + 1] = x[:, :na], x[:, na:]
        if rng is None and len(x) == 1 and not np.isfinite(x).all():
            a_all[t + 2 :], z_all[t + 2 :] = np.nan, np.nan  # lost: what comes is no run any more
            break
    return a_all, z_all


def _outputs(
    model: MixedModel,
    record: Any,
    series: Series,
    a: Array,
    z: Array,
    rng: np.random.Generator | None,
) -> Array:
    """All outputs y (T, K, ny) in one call of the model."""
    T, K = a.shape[:2]
    rows = T * K
    record = type(record)(*(np.tile(v, T) if np.ndim(v) else v for v in record))
    h, C, R = model.observation(
        a.reshape(rows, -1), np.repeat(series.u, K, axis=0).T, np.repeat(series.t, K), record
    )
    y = h + through(C, z.reshape(rows, -1))
    if rng is not None:
        y += noise(possible_noise(model, READING, R, series.t[0]), y.shape, rng)
    return y.reshape(T, K, model.ny)


def noise(S: Array, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Draws (K, n) from N(0, S), S (n, n) or (K, n, n), possibly singular."""
    e = rng.standard_normal(shape)
    if S.size == 0 or not np.isfinite(S).all():
        return e * (0.0 if S.size == 0 else np.nan)
    S = np.ascontiguousarray(S)
    if S.ndim == 2:
        return np.asarray(e @ psd_cholesky(S).T)
    return through(psd_cholesky_many(S), e)


def step_lengths(series: Series) -> Array:
    """Time steps (T-1,) in seconds; exactly equal ones where sampling is regular."""
    return series.steps if series.dt is None else np.full(len(series) - 1, series.dt)


def check_finite(
    model: MixedModel, record: Any, series: Series, y: Array, a: Array, z: Array
) -> None:
    """Raise ModelError naming the first time at which y (T, K, ny), a or z is not finite, and why."""
    finite = np.ones(len(series), dtype=bool)
    for value in (y, a, z):
        finite &= np.isfinite(value).reshape(len(series), -1).all(axis=1)
    if finite.all():
        return
    row = int(np.argmin(finite))
    what, why = "runs away", "Check theta, the inputs' scale and the time step"
    if unwritten := _no_number(model, record, series, a, row):
        what, why = "ends", unwritten
    raise ModelError(
        f"model '{model.name}': the simulation {what}; at t = {series.t[row]:g} (row {row}) it is not finite "
        f"any more. {why}"
    )


@where_it_fails("")
@np.errstate(all="ignore")
def _no_number(model: MixedModel, record: Any, series: Series, a: Array, row: int) -> str:
    """Why states a (T, K, na) give no numbers at a row, where one was read or came from; "" where they do."""
    seen = model.observation(a[row], series.u[row], float(series.t[row]), record)
    why = no_number(model, "measurement", a[row], seen)
    if why or not row:
        return why
    before, dt = row - 1, float(step_lengths(series)[row - 1])
    came = model.transition(a[before], series.u_step[before], float(series.t[before]), dt, record)
    return no_number(model, "dynamics", a[before], came)
