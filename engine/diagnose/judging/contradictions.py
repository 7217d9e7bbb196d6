"""What speaks against a name that the likelihood has chosen: then it is not said."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from engine.data.series import Series
from engine.diagnose.effects.setting import Setting
from engine.diagnose.refits.refitted import LEAST_ERRORS, Refit
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.score_columns import UNTESTABLE
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.rbpf import rbpf
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.ties import held_as_open, is_open
from engine.words import enumerated, number, with_unit

PARTICLES = (500, 2000)  # for the particle filter's word on a gain; the second where it contradicts
REPEATS = 4
MARGIN = 3.0  # nats, beyond the particle filter's own error, that two filters may differ by
BEYOND, FEW, FEW_OF = (
    1.1,
    3,
    0.01,
)  # of the most a curve reaches; readings, and their share, beyond it
SHARE = 0.5  # of the moment filter's gain, that the particle filter must at least find

Given: TypeAlias = tuple[MixedModel, ThetaLike]  # a model with its parameters


def undetermined(found: Sequence[Round], base: QuasiFit) -> list[str]:
    """A sentence for each effect whose estimated size may as well be zero.

    Where all masses and forces may be twice as large, so may a friction, and where nothing tells the unit of a
    state: none of them is zero. So parameters that were as open in the ``base`` are held.
    """
    may = _open(base)
    return [text for text in (_undetermined(r.refits[0], may) for r in found) if text]


def as_open(found: Sequence[Round], base: QuasiFit) -> list[str]:
    """A sentence for each effect whose size is as little known as parameters that the model has."""
    may, out = _open(base), []
    for refit in (r.refits[0] for r in found):
        known = dict(zip(refit.fit.free, refit.fit.standard_errors.tolist(), strict=True))
        others = [n for n in may if not abs(refit.fit.theta[n]) >= LEAST_ERRORS * known[n]]
        if others and not refit.is_sure and not _undetermined(refit, may):
            out.append(
                f"The size of {refit.effect.name} is as little known as {enumerated(others)}: where one is "
                "known, hold it there (theta=, free=)."
            )
    return out


def _open(base: QuasiFit) -> list[str]:
    """Parameters that may as well be zero, but those that the data say nothing of."""
    known = np.diag(base.information) > 0.0
    values = np.array([base.theta[name] for name in base.free])
    unsure = known & is_open(values, base.standard_errors, LEAST_ERRORS)
    return [name for name, yes in zip(base.free, unsure, strict=True) if yes]


def held_beside(fit: QuasiFit, names: Sequence[str]) -> list[str]:
    """Those of the ``names`` to hold, so that none is open in a fit."""

    def errors(held: list[int]) -> Array:
        rest = fit.holding([fit.free[k] for k in held])
        known = dict(zip(rest.free, rest.standard_errors.tolist(), strict=True))
        return np.array([known.get(name, 0.0) for name in fit.free])

    values = np.array([fit.theta[name] for name in fit.free])
    held = held_as_open(values, np.isin(fit.free, names), errors, LEAST_ERRORS)
    return [fit.free[k] for k in held]


def _undetermined(refit: Refit, may: Sequence[str]) -> str:
    effect = refit.effect
    # of a share or a variance the error is no Gaussian one
    if effect.traits.outliers or effect.traits.of_starts or effect.one_sided:
        return ""
    amplitudes = [effect.size.name, f"{effect.size.name}_sine"]
    fit = refit.fit.holding(held_beside(refit.fit, may))
    at = [fit.free.index(name) for name in amplitudes if name in fit.free]
    values = np.array([fit.theta[fit.free[i]] for i in at])
    covariance = fit.covariance[np.ix_(at, at)]
    if not np.isfinite(covariance).all():
        return _sentence(refit)
    wald = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
    return "" if wald >= LEAST_ERRORS**2 else _sentence(refit)


def _sentence(refit: Refit) -> str:
    value, error = refit.sized
    size = with_unit(value, refit.effect.size.unit)
    by = f"its standard error is {number(error)}" if np.isfinite(error) else "it has no error"
    return (
        f"{refit.effect.name} explains the data, but its size is not determined by them ({size}, "
        f"{by}): it stands in for something else."
    )


def already_there(found: Sequence[Round]) -> dict[str, str]:
    """A sentence for each effect, one of several, that is a term of the model as it was given, by its name.

    Before anything was found the fitted parameters took up all that such an effect could show. Beside another
    one it may show something: that what was found acts on a part of what its name says, before or behind that
    term. Then neither name is the cause.
    """
    if len(found) < 2:
        return {}
    taken_up = {
        score.effect.name for score in found[0].screen.scores if 0.0 < score.rho <= UNTESTABLE
    }
    names = [r.refits[0].effect.name for r in found]
    out = {}
    for name in names:
        if name in taken_up:
            others = enumerated([other for other in names if other != name])
            out[name] = (
                f"{name} is a term that the model has already: before anything was found, its parameters took "
                f"up all that it could show. That it shows beside {others} says that {others} acts on a part "
                "only of what its name says: these names are not the cause."
            )
    return out


def folded(found: Sequence[Round], series: Series, setting: Setting) -> list[str]:
    """A sentence for each cubic sensor that readings go beyond, as its curve turns back before it gets there.

    x + c x^3 with c < 0 turns at x = 1 / sqrt(-3 c), where it is two thirds of that. No sensor shows more than
    its curve has, so readings beyond are noise to such a model, and its runs turn over.
    """
    out = []
    for effect, fit in ((r.refits[0].effect, r.refits[0].fit) for r in found):
        size = float(fit.theta[effect.size.name]) if effect.kind == "cubic-sensor" else 0.0
        if not size < 0.0:
            continue
        names = fit.model.parameter_names
        zero = fit.theta[effect.zero] if effect.zero in names else setting.zero(effect.channel)
        turn = 1.0 / np.sqrt(-3.0 * size)
        y = series.y[:, list(setting.model.outputs).index(effect.channel)]
        beyond = int((np.abs(y - zero) > BEYOND * turn * 2.0 / 3.0).sum())
        if beyond >= max(FEW, np.ceil(FEW_OF * np.isfinite(y).sum())):
            unit = setting.unit(effect.channel)
            out.append(
                f"The curve of {effect.name} turns back {with_unit(float(turn), unit)} from its zero, and "
                f"{beyond} readings lie beyond all that it reaches: no sensor reads so, the name stands in for "
                "something else."
            )
    return out


def particle_word(
    before: Given, after: Given, moment: float, series: Series, seed: int
) -> tuple[str, bool]:
    """What the particle filter says of a log-likelihood gained, and whether it contradicts.

    ``before`` and ``after`` are models with their parameters, ``moment`` is the gain by the moment filter.
    """
    for particles in PARTICLES:
        gain, error = _particle_gain(before, after, series, particles, seed)
        if not (np.isfinite(gain) and np.isfinite(error)):
            lost = f"The particle filter ({particles} particles) is lost on one of the models."
            return lost, False
        text = _gained(moment, gain, error, particles)
        if not (abs(gain - moment) > MARGIN + 3.0 * error and gain < SHARE * moment):
            return text, False
    return f"{text} They contradict each other, so the cause is not certain.", True


def _gained(moment: float, gain: float, error: float, particles: int) -> str:
    runs = f"({particles} particles, {REPEATS} runs)"
    text = f"Log-likelihood gained: {moment:.1f} by the moment filter"
    if error > abs(moment):  # of readings nearly free of noise, by orders of magnitude
        return f"{text}; the particle filter {runs} scatters by more and does not tell."
    return f"{text}, {gain:.1f} +- {error:.1f} by the particle filter {runs}."


def _particle_gain(
    before: Given, after: Given, series: Series, particles: int, seed: int
) -> tuple[float, float]:
    """The gain with its standard error, over REPEATS runs with common seeds.

    The logarithm of a particle filter's likelihood is too low by half its own variance (Pitt, dos Santos
    Silva, Giordani, Kohn 2012, section 4), which is much where the readings are nearly free of noise.
    """

    def run(given: Given, k: int) -> float:
        return rbpf(*given, series, particles, np.random.default_rng([seed, k])).log_likelihood

    return debiased(np.array([[run(before, k), run(after, k)] for k in range(REPEATS)]))


def debiased(values: Array) -> tuple[float, float]:
    """The mean gain of runs (n, 2) before and after, without that bias, and its standard error."""
    n = len(values)
    variances = values.var(axis=0, ddof=1)
    gain = (values[:, 1] - values[:, 0]).mean() + 0.5 * (variances[1] - variances[0])
    doubt = 0.5 * variances.sum()  # of so few runs it is known about as badly as it is large
    scatter = (values[:, 1] - values[:, 0]).std(ddof=1) / n**0.5
    return float(gain), float(np.hypot(scatter, doubt))
