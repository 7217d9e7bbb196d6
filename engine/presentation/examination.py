"""An estimate looked at: smoothed states, simulation and prediction against the data, residuals, as data.

The documents made here are those of ``GET /jobs/{id}/results`` too;
:func:`engine.presentation.report.write_report` makes a page of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from engine.data.given import as_series_list, check_apart, same_clock
from engine.data.series import Series
from engine.diagnose.symptoms.symptoms import find_symptoms
from engine.errors import EngineError, ModelError
from engine.estimation.em import EmResult
from engine.estimation.uncertainty import LikelihoodIntervals, StandardErrors
from engine.filters.rbpf import rbpf
from engine.json_values import plain
from engine.presentation.held_out import held_out
from engine.presentation.report import write_report
from engine.randomness import check_seed
from engine.smoothers.exact_conditional import condition_on_trajectories
from engine.smoothers.rb_ffbsi import rb_ffbsi
from engine.statespace.base import BaseModel
from engine.statespace.model import Array, MixedModel, ThetaLike
from engine.threads import single_threaded
from engine.views import Shown, View, sheet, tables
from engine.words import tidy

AFTER_START = ("log_likelihood", "ess", "seconds")  # of a trace


@dataclass(frozen=True, eq=False)
class Examination(Shown):
    """The result of :func:`examine`: simulation and prediction against the data, residuals, held-out error.

    Attributes
    ----------
    document : dict
        All of it as JSON values, as pages and reports show it.
    """

    document: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """The JSON document."""
        return self.document

    def report(self, path: str | Path) -> Path:
        """Write one self-contained HTML file, which opens from disk and prints; returns its path."""
        return write_report(self.document, path)

    def _view(self) -> View:
        found = self.document
        errors = [
            (one["output"], one["rmse"], tidy(one["unit"]))
            for one in found.get("held_out", {}).get("outputs", ())
        ]
        looked_at = found["examination"]["series"]
        sentences = [
            line for one in looked_at for line in one.get("sentences", [one.get("problem")])
        ]
        return sheet(
            f"{found['model']['name']}: examined",
            *map(tables().line, [found["message"], found["warning"], *sentences]),
            tables().table(("output", "error on held-out data, rms", "unit"), errors),
            tables().line("report(path) writes pictures and tables, to_dict() has the numbers."),
        )


@single_threaded
def examine(
    found: EmResult,
    series: Series | Sequence[Series],
    errors: StandardErrors | None = None,
    intervals: LikelihoodIntervals | None = None,
    n_particles: int = 100,
    seed: int = 0,
    test: Series | Sequence[Series] | None = None,
) -> Examination:
    """Evaluate an estimate on the series it comes from.

    Parameters
    ----------
    found : EmResult
        The estimate to evaluate, as :func:`rbps_em`, :func:`ps_em` or :func:`rts_em` returns it.
    series : Series or sequence of Series
        One experiment or several; y (T, ny) with NaN where missing, u (T, nu), times.
    errors : StandardErrors, optional
        Its standard errors; with them the simulation's bands hold the parameters' uncertainty.
    intervals : LikelihoodIntervals, optional
        Likelihood-ratio intervals, shown in place of those that the standard errors give.
    n_particles : int
        Particles and trajectories by which states are smoothed.
    seed : int
        Seed of all random numbers; the same seed gives the same result to the last bit.
    test : Series or sequence of Series, optional
        Held-out data, on which the error of the simulation is measured. Where its times go on at the end of a
        series, it begins at the last state of that series.

    Returns
    -------
    Examination
        The document that pages and reports show.

    Raises
    ------
    ModelError
        The model is no :class:`MixedModel`.
    OptionError
        An option is not known or out of its range; ``field`` names it.
    SeriesError
        Channels or units are not the model's, or nothing was measured; names the channel. Or a test is one of
        the series.
    """
    model = found.model
    if not isinstance(model, MixedModel):
        raise ModelError(
            f"model '{model.name}' is no mixed model; there is nothing to smooth it by"
        )
    all_series = as_series_list(series, model)
    tests = [] if test is None else as_series_list(test, model, "test")
    same_clock([*all_series, *tests])
    check_apart(all_series, tests)
    check_seed(seed)
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    states = [
        smoothed(model, found.theta, one, n_particles, n_particles, rng) for one in all_series
    ]
    document = {
        **estimation_document(
            model, found.theta, found.free, all_series, states, (errors, intervals), seed
        ),
        "outcome": found.outcome.word,
        "message": found.message,
        "trace": trace_document(model.parameter_names, vars(found)),
    }
    if test is not None:
        document["held_out"] = held_out(model, found.theta, tests, all_series)
    return Examination(plain(document))


def smoothed(
    model: MixedModel, theta: ThetaLike, series: Series, M: int, N: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Means and standard deviations (T, nx) of the states by M particles and N trajectories.

    Given whole trajectories of a, so without Algorithm 3's lasting bias.
    """
    draws = rb_ffbsi(rbpf(model, theta, series, M, rng), N, rng, joint=True)
    exact = condition_on_trajectories(draws)
    return exact.mean(), exact.std()


Uncertainty = tuple[StandardErrors | None, LikelihoodIntervals | None]


def estimation_document(
    model: MixedModel,
    theta: ThetaLike,
    free: Sequence[str],
    series: Sequence[Series],
    states: Sequence[tuple[Array, Array]],
    uncertainty: Uncertainty,
    seed: int,
) -> dict[str, Any]:
    """An estimate on the series it comes from; ``states`` are smoothed means and standard deviations."""
    errors, intervals = uncertainty
    return {
        "model": model_document(model),
        "time_unit": series[0].time_unit,
        "estimate": estimate_document(model, theta, free, errors, intervals),
        "warning": " ".join(one.warning for one in uncertainty if one and one.warning),
        "states": states_document(model, series, states),
        "examination": examination(model, theta, series, covariance_of(model, errors), seed),
    }


def model_document(model: MixedModel) -> dict[str, Any]:
    """Names, units and equations of a model."""
    return {
        "name": model.name,
        "description": model.description,
        "equations": list(model.equations),
        "states": {**model.nonlinear, **model.linear},
        "inputs": dict(model.inputs),
        "outputs": dict(model.outputs),
    }


def estimate_document(
    model: BaseModel,
    theta: ThetaLike,
    free: Sequence[str],
    errors: StandardErrors | None,
    intervals: LikelihoodIntervals | None = None,
) -> dict[str, Any]:
    """Each parameter's value, standard error, 95 % interval and unit; None for what is not known.

    Intervals are those by the likelihood ratio, or symmetric ones where these are not given; an
    interval without an end is None.
    """
    out: dict[str, Any] = {}
    values = model.theta(theta)
    for i, p in enumerate(model.parameters):
        value, error, interval = float(values[i]), None, None
        if errors is not None and np.isfinite(errors.values[i]):
            error = float(errors.values[i])
            ends = (errors.interval() if intervals is None else intervals.values)[i]
            interval = ends.tolist() if np.isfinite(ends).all() else None
        out[p.name] = {
            "value": value,
            "standard_error": error,
            "interval": interval,
            "unit": p.unit,
        }
        if p.name not in free:
            out[p.name]["fixed"] = True
    return out


def trace_document(names: Sequence[str], found: Mapping[str, Any]) -> dict[str, Any]:
    """Every iteration; row 0 is the start. ``found`` has the members of an :class:`engine.EmResult`."""
    trace = np.asarray(found["trace"])
    # a log-likelihood belongs to the theta before its M step; row 0 has none
    after = {key: [None, *np.asarray(found[key]).tolist()] for key in AFTER_START}
    theta = {name: trace[:, i].tolist() for i, name in enumerate(names)}
    return {"iteration": list(range(len(trace))), "theta": theta, **after}


def states_document(
    model: MixedModel, series: Sequence[Series], states: Sequence[tuple[Array, Array]]
) -> dict[str, Any]:
    """Means and standard deviations (T, nx) of each series' states by name, with units, at its samples."""
    names = [*model.nonlinear, *model.linear]
    out = []
    for one, (mean, sd) in zip(series, states, strict=True):
        columns = {"mean": mean[one.samples], "standard_deviation": sd[one.samples]}
        by_name = {
            key: {name: values[:, i].tolist() for i, name in enumerate(names)}
            for key, values in columns.items()
        }
        out.append({"t": one.t[one.samples].tolist(), **by_name})
    return {"units": {**model.nonlinear, **model.linear}, "series": out}


def covariance_of(model: MixedModel, errors: StandardErrors | None) -> Array | None:
    """The covariance (n_theta, n_theta) of an estimate, zero for parameters that were held."""
    if errors is None:
        return None
    indices = [model.index(name) for name in errors.names]
    out = np.zeros((len(model.parameters), len(model.parameters)))
    out[np.ix_(indices, indices)] = errors.covariance
    return out


def examination(
    model: MixedModel,
    theta: ThetaLike,
    series: Sequence[Series],
    covariance: Array | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Symptoms of each series as data; where they cannot be had, ``problem`` says why.

    A model whose moment filter is lost, or whose simulation cannot be drawn, still has its estimate.
    """
    out: list[dict[str, Any]] = []
    for one in series:
        try:
            out.append(find_symptoms(model, theta, one, covariance, seed=seed).to_dict())
        except (EngineError, np.linalg.LinAlgError) as error:
            out.append({"problem": f"Simulation and residuals are not known: {error}"})
    return {"series": out}
