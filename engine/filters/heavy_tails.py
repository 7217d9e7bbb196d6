"""Noise with outliers in a mixed model, by scale mixtures; the poster's problem class carried over.

e_t ~ N(0, s_t R) with a random s_t of its own at each time is Student-t where 1/s_t is Gamma, and a
Gaussian mixture where s_t takes two values; likewise w_t. Given s_t all is as before, so z stays
conditionally Gaussian. s_t = s(g_t) of one more nonlinear state without memory, g_{t+1} = m + w_g,
w_g ~ N(0, 1): a Gaussian pushed through its distribution function and the inverse one of s. The
result is an ordinary :class:`engine.MixedModel`, whose new parameters are estimated like any other.

    Student-t   m = 0,                 1/s = F^{-1}(Phi(-g)),  F of Gamma(nu/2, rate nu/2)
    mixture     m = Phi^{-1}(share),   s = ratio^2 where g > 0, else 1
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import gammainccinv, gammaincinv, ndtr, ndtri

from engine.errors import OptionError
from engine.filters.proposals import Step
from engine.filters.scale_mixture_proposal import MixingProposal, WithoutScale
from engine.statespace.model import Array, MixedModel, Parameter
from engine.statespace.promotion import product
from engine.statespace.random_scale import RandomScale
from engine.statespace.recorded.stand_ins import Within, traceable
from engine.statespace.split import Split

LARGEST = 23.0  # of log s: noise a hundred thousand times as large is as good as no measurement
FAR = 8.0  # |g| beyond which s is held constant; it is never drawn
TAIL = 12  # strata halve towards large s as often as this


@dataclass(frozen=True)
class Mixing:
    """The distribution of s: ``mean(values)`` of g, ``scale(g, values)`` = s, and the ``edges(values)``

    of strata of Phi(g - mean), finer where s is large. ``values`` are those of ``parameters``.
    """

    parameters: tuple[Parameter, ...]
    mean: Callable[[Any], Any]
    scale: Callable[[Array, Any], Array]
    edges: Callable[[Any], Array]

    def roots(self, g: Array, values: Any, mask: Array) -> Array:
        """Factors (M, k) of the standard deviations, 1 where the ``mask`` (k,) is False."""
        return np.where(mask, np.sqrt(self.scale(g, values))[:, None], 1.0)


def with_student_t(
    model: MixedModel,
    where: str = "measurement",
    nu_default: float = 4.0,
    channels: Sequence[str] | None = None,
    name: str = "nu",
) -> MixedModel:
    """The model with Student-t noise.

    R (or Q) is the scale matrix of the noise, which is its covariance over nu / (nu - 2).

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    where : str
        ``measurement`` (e) or ``dynamics`` (w).
    nu_default : float
        Default degrees of freedom.
    channels : sequence of str, optional
        Outputs, or states, that share the random factor of their noise; all by default.
    name : str
        Of the new parameter and, as ``g_<name>``, of the new state.

    Returns
    -------
    MixedModel
        The extended model.

    Raises
    ------
    OptionError
        An option is not known or out of its range; ``field`` names it.
    """
    tail = 1.0 - 0.5 ** np.arange(3, TAIL + 1)
    edges = np.concatenate([[0.0, 0.1, 0.25, 0.5, 0.75], tail, [1.0]])
    mixing = Mixing(
        (Parameter(name, nu_default, "1", (0.5, 200.0), "degrees of freedom of the noise"),),
        lambda values: 0.0,
        _student_scale,
        lambda values: edges,
    )
    made = with_student_t, (model, where, nu_default, channels, name)
    return _with_mixing(model, mixing, where, channels, f"g_{name}", made)


def with_mixture(
    model: MixedModel,
    where: str = "measurement",
    share_default: float = 0.02,
    ratio_default: float = 10.0,
    channels: Sequence[str] | None = None,
    name: str = "outlier",
) -> MixedModel:
    """The model with a share of outliers in its noise.

    Parameters
    ----------
    model : MixedModel
        The model, paper, eq. (1).
    where : str
        ``measurement`` (e) or ``dynamics`` (w).
    share_default : float
        Default of ``<name>_share``, the probability of an outlier.
    ratio_default : float
        Default of ``<name>_ratio``, the outliers' standard deviation over the usual one.
    channels : sequence of str, optional
        Outputs, or states, that share the random factor of their noise; all by default.
    name : str
        Of the new parameters and, as ``g_<name>``, of the new state.

    Returns
    -------
    MixedModel
        The extended model.

    Raises
    ------
    OptionError
        An option is not known or out of its range; ``field`` names it.
    """
    mixing = Mixing(
        (
            Parameter(f"{name}_share", share_default, "1", (1e-6, 0.5), "share of outliers"),
            Parameter(f"{name}_ratio", ratio_default, "1", (1.0, 1e4), "their size over the usual"),
        ),
        lambda values: ndtri(values[0]),
        _mixture_scale,
        lambda values: np.array([0.0, 1.0 - values[0], 1.0]),
    )
    made = with_mixture, (model, where, share_default, ratio_default, channels, name)
    return _with_mixing(model, mixing, where, channels, f"g_{name}", made)


def _student_scale(g: Array, values: Any) -> Array:
    nu = values[0]
    exact = np.ndim(nu) > 0  # one nu for each row
    log_s = _log_scale(g, nu) if exact else _log_scale_table(float(nu))(np.clip(g, -FAR, FAR))
    return np.asarray(np.exp(np.minimum(log_s, LARGEST)))


def _log_scale(g: Array, nu: Any) -> Array:
    """-log F^{-1}(Phi(-g)) for F of Gamma(nu/2, rate nu/2); accurate in both tails."""
    half = 0.5 * nu
    low, high = np.minimum(ndtr(-g), 0.5), np.minimum(ndtr(g), 0.5)
    rate = np.where(g > 0.0, gammaincinv(half, low), gammainccinv(half, high))
    return np.asarray(np.log(half) - np.log(rate))


@lru_cache(maxsize=256)
def _log_scale_table(nu: float) -> CubicSpline:
    """``_log_scale`` by interpolation, to about 1e-8: the inverse itself takes 100 times as long."""
    g = np.linspace(-FAR, FAR, 601)
    return CubicSpline(g, _log_scale(g, nu))


def _mixture_scale(g: Array, values: Any) -> Array:
    return np.where(g > 0.0, values[1] ** 2 + 0.0 * g, 1.0)


Made: TypeAlias = tuple[Callable[..., MixedModel], tuple[Any, ...]]


class _Part:
    """A function of a model that was ``made`` by a call: pickled as that call, as one within it cannot be."""

    hands_rows_on = True  # to the functions of the model within, see engine.statespace.evaluation

    def __init__(self, function: Callable[..., Any], made: Made) -> None:
        self.function, self.made = function, made

    def __call__(self, *given: Any) -> Any:
        return self.function(*given)

    @property
    def traced(self) -> Any:
        """The same for a row of numbers that are being recorded."""
        return traceable(self.function, Within())

    def __reduce__(self) -> tuple[Any, ...]:
        return _part, (*self.made, self.function.__name__)


SCALE = ("mean", "edges", "propose")  # of a random scale


def _part(maker: Callable[..., MixedModel], given: tuple[Any, ...], name: str) -> Any:
    """The function of that name of a model, or of its last random scale, made again."""
    model = maker(*given)
    return getattr(model.random_scales[-1] if name in SCALE else model, name)


def _with_mixing(
    model: MixedModel,
    mixing: Mixing,
    where: str,
    channels: Sequence[str] | None,
    state: str,
    made: Made,
) -> MixedModel:
    known = list(model.outputs) if where == "measurement" else [*model.nonlinear, *model.linear]
    if where not in ("measurement", "dynamics"):
        raise OptionError(f"where '{where}' is not known; use measurement or dynamics", "where")
    for channel in channels or ():
        if channel not in known:
            raise OptionError(
                f"model '{model.name}' has no '{channel}' in its {where}; it has {', '.join(known)}",
                "channels",
            )
    new = [parameter.name for parameter in mixing.parameters]
    if state in (*model.nonlinear, *model.linear) or set(new) & set(model.parameter_names):
        raise OptionError(
            f"model '{model.name}' already has '{state}' or {new}; pass another name=", "name"
        )
    mask = np.array([channels is None or channel in channels for channel in known])
    na, n, split = model.na, len(model.parameters), Split(model)
    there = np.delete(np.arange(model.nx + 1), na)  # rows of the old states among the new

    def factors(g: Array, theta: Any) -> Array:
        """The factor (M, k, k) of R or Q."""
        root = mixing.roots(g, theta[n:], mask)
        return np.asarray(root[:, :, None] * root[:, None, :])

    def dynamics(a: Array, u: Any, t: Any, dt: Any, theta: Any) -> tuple[Any, Any, Any]:
        inner = np.ascontiguousarray(a[:, :na])
        f_, A_, Q_ = model.transition(inner, u, t, dt, split(theta)[0])
        if where == "dynamics":
            Q_ = Q_ * factors(a[:, na], theta)
        f = np.empty((len(a), model.nx + 1))
        f[:, there] = f_
        f[:, na] = mixing.mean(theta[n:])
        A = np.zeros((*A_.shape[:-2], model.nx + 1, model.nz))
        A[..., there, :] = A_
        Q = np.zeros((*Q_.shape[:-2], model.nx + 1, model.nx + 1))
        Q[..., there[:, None], there] = Q_
        Q[..., na, na] = 1.0
        return f, A, Q

    def measurement(a: Array, u: Any, t: Any, theta: Any) -> tuple[Any, Any, Any]:
        inner = np.ascontiguousarray(a[:, :na])
        h, C, R = model.observation(inner, u, t, split(theta)[0])
        return h, C, R * factors(a[:, na], theta) if where == "measurement" else R

    def propose(step: Step) -> tuple[Array, Array]:
        """Draw all of a, g included, of this model or of one that effects were added to."""
        values = [getattr(step.theta, name) for name in new]
        others = WithoutScale(step.model, state, float(mixing.mean(values)))
        usual = mixing.roots(np.array([others.g]), values, mask)
        return MixingProposal(
            others,
            step.theta,
            float(mixing.mean(values)),
            mixing.edges(values),
            lambda g: mixing.roots(g, values, mask) / usual,
            where == "measurement",
        )(step)

    def mean(values: Any) -> Any:
        return mixing.mean(values)

    def edges(values: Any) -> Any:
        return mixing.edges(values)

    def initial(theta: Any) -> tuple[Any, Any, Any]:
        start = model.start(split(theta)[0])
        middle = float(mixing.mean(theta[n:]))
        density = product(start.density, lambda a: (np.full((len(a), 1), middle), np.eye(1)), na)
        z1, P1 = start.z1, start.P1
        return (
            density,
            (lambda a: z1(a[:, :na])) if callable(z1) else z1,
            (lambda a: P1(a[:, :na])) if callable(P1) else P1,
        )

    return replace(
        model,
        nonlinear={**model.nonlinear, state: "1"},
        parameters=[*model.parameters, *mixing.parameters],
        dynamics=_Part(dynamics, made),
        measurement=_Part(measurement, made),
        initial=_Part(initial, made),
        equations=[*model.equations, f"{where}: noise scaled by s({state}), {state} ~ N(m, 1)"],
        random_scales=[
            *model.random_scales,
            RandomScale(state, tuple(new), *(_Part(one, made) for one in (mean, edges, propose))),
        ],
    )
