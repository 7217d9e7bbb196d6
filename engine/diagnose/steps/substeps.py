"""More than one step of the model from one sample to the next, so that effects act within the step.

An effect is added step by step; where a step is long beside what the model does within it, the error of
that passes for physics of its own. A model that declares ``continuous`` is therefore run on k steps a
sample, nothing measured in between, its inputs held. Whether its dt is a real one is verified first: two
half-steps must agree with one up to the order of the scheme, in mean and covariance. k is doubled until
neither the free run of the model nor what typical effects do over a sample changes by much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.data.rounded_times import rounding_of
from engine.data.series import Series
from engine.diagnose.effects.catalogue import COUNTING, all_effects, extend
from engine.diagnose.effects.effect import Effect
from engine.diagnose.effects.kinds.time_step import KIND as TIME_STEP
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.rates import Points
from engine.diagnose.effects.setting import ON_TIME, Setting
from engine.diagnose.records import Records
from engine.diagnose.symptoms.runs import start_state
from engine.errors import EngineError
from engine.simulation.step_length import FREE_RUN, MOST, change_of_run, run_at_samples
from engine.statespace.half_steps import step
from engine.statespace.model import Array, MixedModel

BY_EFFECT = 0.05  # of what an effect does to the outputs: error that is small enough
MOSTLY = 0.75  # share of the effects of which it must be so small
STRETCH = 60  # samples over which that is looked at
TYPICAL = 0.03  # of what a state moves over a sample: what an effect does to it
KINDS = ("force", "linear", "coupling", "drag", "cubic")  # effects that are looked at
LOOKED_AT = 12  # samples
# Another size of an effect is tried so often, each this share of the last at least, until one comes so close.
SIZES_TRIED, LEAST_SHARE, CLOSE = 200, 1e-3, 1.5
SHORT = 1.0 / 16.0  # of a sample: steps at which the order of the scheme shows
FASTER, SLOWER = 0.4, 0.75  # an error of order h^2, of order h, falls below these where h is halved
EXACT = 1e-8  # of a state's size: a difference that is rounding
# of a covariance: a rule for Q that ends up so near, however short the step, will do
ALIKE_NOISE = 0.05
MUCH = 0.5  # of the free run's residual: change by which the steps are what it is mostly wrong by


@dataclass(frozen=True, eq=False)
class Prepared:
    """The records to work on, ``k`` steps a sample, what there is to say about it, and the base's theta.

    ``theta`` is None for a model that was not looked at, as it does not declare ``continuous`` or counts steps.
    ``finer`` is whether more steps mean anything.
    """

    records: Records
    k: int = 1
    notes: tuple[str, ...] = ()
    theta: Array | None = None
    finer: bool = False

    def with_shorter_steps(self, given: Records, k: int) -> Prepared:
        """The records ``given`` with ``k`` steps a sample, as what was found needs them."""
        text = f"The model makes {k} steps a sample: with fewer, their error is in what is found."
        return replace(self, records=given.refined(k), k=k, notes=(text,), finer=k < MOST)


def prepare(
    model: MixedModel,
    records: Records,
    fitted: Callable[[], Array],
    part: Series | None = None,
) -> Prepared:
    """The records with as many steps a sample as a continuous model needs for its effects.

    ``fitted`` estimates the model's theta (n_theta,) on the main record as it is, or on a ``part`` of it that
    is looked at. A lag or a delay counts samples. So records that are sampled regularly, tests too, must be at
    one common step, else one step a sample is kept; where the main one is not, nothing that counts is asked.
    """
    if not model.continuous or model.steps_counted:
        text = "" if model.steps_counted else undeclared(model, records.main)
        return Prepared(records, notes=(text,) if text else ())
    regular = records.main.dt is not None
    if regular and not all(_regular(records.main, one) for one in records.every):
        text = "Samples are not at one common step: the model makes one step a sample."
        return Prepared(records, notes=(text,))
    theta = fitted()
    part = records.main if part is None else part
    setting = setting_for(model, part, theta)
    if not is_consistent(model, theta, sampled(setting)):
        text = (
            f"Model '{model.name}' declares a real time step (continuous=True), but two half-steps do not "
            "agree with one: one step a sample is kept."
        )
        return Prepared(records, notes=(text,), theta=theta)
    k = choose(setting, part, theta)
    notes = [f"The model makes {k} steps a sample, so that effects act within it."] if k > 1 else []
    if not regular and (k > 1 or not setting.tells_samples):
        notes.append(
            f"Samples are not at one common step, so nothing that counts samples ({', '.join(COUNTING)}) is "
            "looked for."
        )
    return Prepared(records.refined(k), k, tuple(notes), theta, finer=k < MOST)


def undeclared(model: MixedModel, series: Series) -> str:
    """What to declare of a model of steps that are those of a differential equation; else ""."""
    theta = np.asarray(model.theta())
    try:
        setting = setting_for(model, series, theta)
        if all_effects(setting, [TIME_STEP]):
            return ""  # where a drive comes to rest, say
        points = sampled(setting)
        mean, cov = _halving(model, theta, points, 1.0)
        moved = [
            step(model, theta, x[None], u, t, dt)[0] - x
            for x, u, t, dt in zip(points.x, points.u, points.t, points.dt, strict=True)
        ]
    except (EngineError, np.linalg.LinAlgError):
        return ""
    still = float(np.abs(np.array(moved) / points.scale).max(initial=0.0)) <= EXACT
    if still or not (float(mean.max(initial=0.0)) <= EXACT and cov <= ALIKE_NOISE):
        return ""
    return (
        f"Two half-steps of model '{model.name}' agree with one, so its steps may be shorter than a sample: "
        "declare it (continuous=True). Until then effects act at the end of a step, and what that gets "
        "wrong of a strong one may be given a name of its own."
    )


def can_be_finer(setting: Setting, series: Series, theta: Array, names: Sequence[str] = ()) -> bool:
    """Whether more steps a sample mean anything: of a model whose dt is a real one, with effects ``names``."""
    model = setting.model
    if not model.continuous or model.steps_counted or not have_finer(names, series):
        return False
    return is_consistent(model, theta, sampled(setting))


def have_finer(names: Sequence[str], series: Series) -> bool:
    """Whether effects, by their names, can be had with more steps a sample than the series has.

    What counts samples cannot where these are at no common step: times do not tell them from the steps between.
    """
    return all(name.partition(":")[0] not in COUNTING for name in names) or series.dt is not None


def _regular(series: Series, other: Series) -> bool:
    if series.dt is None:
        return False
    phase = (float(other.t[0]) - float(series.t[0])) / series.dt
    same = other.dt is not None and abs(other.dt / series.dt - 1.0) < ON_TIME
    off = max(rounding_of(series.t), rounding_of(other.t)) / series.dt
    return same and abs(phase - round(phase)) < ON_TIME + off


def is_consistent(model: MixedModel, theta: Array, points: Points) -> bool:
    """Whether two half-steps agree with one up to the order of the scheme, in mean and covariance."""
    errors = [_halving(model, theta, points, SHORT * way) for way in (1.0, 0.5)]
    (mean, cov), (finer_mean, finer_cov) = errors
    fine = (mean <= EXACT) | (finer_mean <= FASTER * mean)
    alike = max(cov, finer_cov) <= ALIKE_NOISE
    return bool(fine.all() and (alike or finer_cov <= SLOWER * cov))


def _halving(model: MixedModel, theta: Array, points: Points, share: float) -> tuple[Array, float]:
    """Differences of two half-steps and one: of each mean (nx,), in its size; of Q as a share of it."""
    means, covs = [], []
    for x, u, t, dt in zip(points.x, points.u, points.t, share * points.dt, strict=True):
        whole, Q = _moments(model, theta, x, None, u, t, dt)
        half, P = _moments(model, theta, x, None, u, t, 0.5 * dt)
        twice, P = _moments(model, theta, half, P, u, t + 0.5 * dt, 0.5 * dt, points.scale)
        means.append(np.abs(twice - whole) / points.scale)
        noise = np.sqrt(np.maximum(np.diagonal(Q), 0.0))
        noisy = np.flatnonzero(noise > 0.0)
        off = (P - Q)[np.ix_(noisy, noisy)] / np.outer(noise[noisy], noise[noisy])
        covs.append(float(np.abs(off).max(initial=0.0)))
    return np.median(means, axis=0), float(np.median(covs))


def _moments(
    model: MixedModel,
    theta: Array,
    x: Array,
    P: Array | None,
    u: Array,
    t: float,
    dt: float,
    scale: Array | None = None,
) -> tuple[Array, Array]:
    """Mean and covariance after a step from N(x, P), linearised; P None for a known x."""
    mean = step(model, theta, x[None], u, t, dt)[0]
    _, _, Q = model.transition(x[None, : model.na], u, t, dt, model.record(theta))
    Q = Q if Q.ndim == 2 else Q[0]
    if P is None or scale is None:
        return mean, Q
    ways = x + 1e-5 * np.vstack([np.diag(scale), -np.diag(scale)])
    ends = step(model, theta, ways, u, t, dt)
    F = ((ends[: model.nx] - ends[model.nx :]) / (2e-5 * scale[:, None])).T
    return mean, F @ P @ F.T + Q


def choose(setting: Setting, series: Series, theta: Array) -> int:
    """The least number of steps a sample that is enough, in powers of two, up to MOST."""
    model, k = setting.model, 1
    try:
        x1, _ = start_state(model, theta, series)
    except (EngineError, np.linalg.LinAlgError):
        return 1
    part = series.part(0, min(len(series), STRETCH))
    effects = _sized(setting, theta)
    run, done = run_at_samples(model, theta, series, x1), _done(setting, theta, effects, part, x1)
    while k < MOST:
        finer_run = run_at_samples(model, theta, series.refined(2 * k), x1)
        finer = _done(setting, theta, effects, part.refined(2 * k), x1)
        if _same_run(series, run, finer_run) and _same_effects(done, finer):
            break
        k, run, done = 2 * k, finer_run, finer
    return k


def is_enough(model: MixedModel, theta: Array, series: Series, k: int) -> bool:
    """Whether the free run of an extended model with k steps a sample is that with twice as many.

    Of one that counts them nothing can be said: it was made for k.
    """
    if model.steps_counted:
        return True
    try:
        x1, _ = start_state(model, theta, series.refined(k))
    except (EngineError, np.linalg.LinAlgError):
        return True
    one, other = (run_at_samples(model, theta, series.refined(n), x1) for n in (k, 2 * k))
    return bool(np.isfinite([one, other]).all()) and _same_run(series, one, other)


def are_too_long(
    model: MixedModel, names: Sequence[str], theta: Array, series: Series, x1: Array
) -> bool:
    """Whether much of what the free run of a model with effects gets wrong is an error of its steps.

    ``theta`` are the values of the extended model, ``x1`` (nx,) its first state. False where there are no
    shorter ones, as with what counts samples at irregular times.
    """
    if not have_finer(names, series):
        return False
    plain = series.held(series.hold)
    runs = []
    for k in (series.substeps, 2 * series.substeps):
        fine = plain.refined(k)
        extended = extend(model, names, setting_for(model, fine, theta[: len(model.parameters)]))
        runs.append(run_at_samples(extended, theta, fine, x1))
    return bool(np.isfinite(runs).all()) and not _same_run(plain, runs[0], runs[1], MUCH)


def steps_for(
    model: MixedModel, names: Sequence[str], theta: Array, series: Series, x1: Array
) -> int:
    """How many steps a sample a model with effects needs where those of the series are too long.

    At least twice as many; arguments as of :func:`are_too_long`.
    """
    k, plain = 2 * series.substeps, series.held(series.hold)
    while k < MOST and are_too_long(model, names, theta, plain.refined(k), x1):
        k *= 2
    return k


def _done(
    setting: Setting, theta: Array, effects: list[tuple[Effect, float]], series: Series, x1: Array
) -> list[Array]:
    """What each effect, at its size, does to the outputs of the free run."""
    states = list(setting.states)
    without, out = run_at_samples(setting.model, theta, series, x1), []
    for effect, size in effects:
        extended = effect.apply(setting.model)
        order = [states.index(name) for name in [*extended.nonlinear, *extended.linear]]
        own = np.array([*theta, size, *effect.probes[0]])
        out.append(run_at_samples(extended, own, series, x1[order]) - without)
    return out


def _same_run(series: Series, one: Array, other: Array, share: float = FREE_RUN) -> bool:
    return not change_of_run(series, one, other) > share


def _same_effects(one: list[Array], other: list[Array]) -> bool:
    """Of most effects: where friction sticks and slips, the answer to a small force is erratic."""
    errors = [
        float(np.linalg.norm(y - x) / np.linalg.norm(y))
        for x, y in zip(one, other, strict=True)
        if np.isfinite(x).all() and np.isfinite(y).all() and y.any()
    ]
    return not errors or float(np.quantile(errors, MOSTLY)) <= BY_EFFECT


def sampled(setting: Setting) -> Points:
    """A few samples of the record."""
    points, _ = setting.points(setting.model)
    rows = np.unique(np.linspace(0, len(points.t) - 1, LOOKED_AT).astype(int))
    return replace(points, x=points.x[rows], u=points.u[rows], t=points.t[rows], dt=points.dt[rows])


def _sized(setting: Setting, theta: Array) -> list[tuple[Effect, float]]:
    """Effects with sizes at which they move their state by TYPICAL of what it moves over a sample."""
    model, points = setting.model, sampled(setting)
    states, out = list(setting.states), []
    rows = list(zip(points.x, points.u, points.t, points.dt, strict=True))
    base = np.array([step(model, theta, x[None], u, t, dt)[0] for x, u, t, dt in rows])
    moves = np.sqrt(np.mean((base - points.x) ** 2, axis=0))
    for effect in all_effects(setting, KINDS):
        target = states.index(effect.channel.rpartition("->")[2])
        wanted = TYPICAL * float(moves[target])
        if wanted > 0.0:
            size = _reaching(wanted, _change(effect, setting, theta, rows, base[:, target]))
            out += [] if size is None else [(effect, size)]
    return out


def _change(
    effect: Effect, setting: Setting, theta: Array, rows: list[tuple[Any, ...]], base: Array
) -> Callable[[float], float]:
    """What an effect of a size changes of a step of its state, root mean square, from ``base`` (n,)."""
    extended = effect.apply(setting.model)
    names = [*extended.nonlinear, *extended.linear]
    order = [list(setting.states).index(name) for name in names]
    row = names.index(effect.channel.rpartition("->")[2])

    def change(size: float) -> float:
        own = np.array([*theta, size, *effect.probes[0]])
        ends = [step(extended, own, x[order][None], u, t, dt)[0, row] for x, u, t, dt in rows]
        return float(np.sqrt(np.mean((np.array(ends) - base) ** 2)))

    return change


@np.errstate(all="ignore")  # sizes are tried that are far too large
def _reaching(wanted: float, change: Callable[[float], float]) -> float | None:
    """The size that changes so much, from 1; None where none is found.

    What an effect does within a step may grow with its size faster than in proportion to it.
    """
    size = 1.0
    for _ in range(SIZES_TRIED):
        now = np.float64(change(size))
        if wanted / CLOSE <= now <= wanted * CLOSE:
            return float(size * wanted / now)
        # without end where the change is lost in rounding
        share = wanted / now if np.isfinite(now) else 0.0
        size *= float(np.clip(share, LEAST_SHARE, 1.0 / LEAST_SHARE))
        if not 0.0 < size < np.inf:
            break
    return None
