"""A diagnosis as JSON values, with all that its pages and reports show."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from engine.design.rivals import to_ask
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.extended import at_bounds, in_the_library
from engine.diagnose.gain.adoption import in_full, in_short
from engine.diagnose.refits.latent_force import UnnamedForce
from engine.diagnose.refits.refitted import Refit
from engine.diagnose.symptoms.curves import named, rounded
from engine.estimation.quasi_ml import QuasiFit
from engine.json_values import plain
from engine.presentation.cause_sentences import experiment, late, sample_step, when
from engine.presentation.diagnosis_text import page, unnamed
from engine.presentation.equations import to_latex

if TYPE_CHECKING:
    from engine.diagnose.diagnosis import Diagnosis
    from engine.diagnose.free_run.missing_function import MissingFunction
    from engine.diagnose.free_run.null import Alarm
    from engine.diagnose.free_run.search import FreeRound
    from engine.diagnose.free_run.second_opinion import SecondOpinion
    from engine.diagnose.gain.gain import Gain
    from engine.diagnose.over_horizon import OverHorizon
    from engine.diagnose.refits.rounds import Round

SCREENED_EFFECTS = 12  # screened effects of a round


def as_dict(d: Diagnosis) -> dict[str, Any]:
    """All of it as JSON values: numbers that are not finite become None."""
    causes = [
        {
            **asdict(cause),
            "latex": to_latex(cause.equation),
            "experiment": experiment(cause),
            "when": when(cause, sample_step(d.series)),
            "late": late(cause, sample_step(d.series), d.series.time_unit),
        }
        for cause in d.causes
    ]
    force = unnamed(d)
    data: dict[str, Any] = {
        "model": d.model.name,
        "description": d.model.description,
        "channels": {
            "states": {**d.model.nonlinear, **d.model.linear},
            "inputs": dict(d.model.inputs),
            "outputs": dict(d.model.outputs),
        },
        "measured": list(d.measured),
        "time_unit": d.series.time_unit,
        "step": sample_step(d.series),
        "samples": len(d.series),
        "verdict": d.verdict.value,
        "sentence": d.verdict.sentence,
        "p_value": d.p_value,
        "at_floor": d.p_at_floor,
        "p_bootstrap": d.p_bootstrap,
        "p_bootstrap_at_floor": d.p_bootstrap_at_floor,
        "causes": causes,
        "unnamed": None if force is None else _force(force),
        "base_theta": d.base_theta.asdict(),
        "base_standard_errors": _errors(d.before),
        "extension": {
            "model": _reference(d),
            "hold": d.series.hold,
            "dt": d.series.dt,
            "equations_before": list(d.model.equations),
            "equations": list(d.extended.equations),
            "theta": d.theta.asdict(),
            "free": list(d.after.free),
            "standard_errors": _errors(d.after),
            "units": {p.name: p.unit for p in d.extended.parameters},
            "at_bounds": {"before": at_bounds(d.before), "after": at_bounds(d.after)},
            "in_the_library": in_the_library(d),
        },
        "free_run": None if d.free_run is None else _free_run(d.free_run),
        "over_horizon": None if d.over_horizon is None else over_horizon(d.over_horizon),
        "symptoms": d.symptoms.to_dict(),
        "next": _next(d),
        "gain": None if d.gain is None else _gain(d.gain, list(d.model.outputs), d.trusted),
        "detectable": [asdict(item) for item in d.detectable],
        "rounds": [_round(found) for found in d.rounds],
        "faults": list(d.faults),
        "stopped": list(d.stopped),
        "why": list(d.why),
        "unsearched": d.unsearched and {**asdict(d.unsearched), "sentence": d.unsearched.sentence},
        "by_record": d.by_record,
        "notes": list(d.notes),
        "seconds": d.seconds,
        "page": page(d),
    }
    cleaned: dict[str, Any] = plain(data)
    return cleaned


def over_horizon(found: OverHorizon) -> dict[str, Any]:
    """The candidates beside each other."""
    return {**asdict(found), "sentence": found.sentence, "instead": found.instead}


def _free_run(asked: SecondOpinion) -> dict[str, Any]:
    """Both criteria side by side, and how the free run came to its answer."""
    found = asked.search
    return {
        "decides": asked.decides,
        "reason": asked.reason,
        "likelihood": {"verdict": asked.likelihood.value, "effects": list(asked.names)},
        "free_run": None
        if found is None
        else {
            "verdict": found.verdict.value,
            "effects": [name for candidate in found.found for name in candidate.names],
        },
        "alarm": None if asked.alarm is None else _alarm(asked.alarm),
        "rounds": [] if found is None else [_free_round(one) for one in found.rounds],
        "missing": None if asked.missing is None else _missing(asked.missing),
    }


def _missing(one: MissingFunction) -> dict[str, Any]:
    """A force without a name, and its curve."""
    curve = {"x": one.x, "mean": one.mean, "standard_deviation": one.sd}
    return {
        "source": one.source,
        "target": one.target,
        "source_unit": one.source_unit,
        "unit": one.unit,
        "left": one.left,
        "p_value": one.p_value,
        "sentence": one.sentence,
        "curve": {name: rounded(values).tolist() for name, values in curve.items()},
    }


def _alarm(alarm: Alarm) -> dict[str, float | bool]:
    return {
        "p_value": alarm.p_value,
        "at_floor": alarm.at_floor,
        "rms": alarm.rms,
        "rms_noise": alarm.rms_noise,
    }


def _free_round(one: FreeRound) -> dict[str, Any]:
    """``share`` of the squared error to first order; ``held_out`` errors on rows left out."""
    left = {c.names for group in one.survivors for c in group}
    return {
        "alarm": _alarm(one.alarm),
        "held_out": one.held_out,
        "screened": [
            {"effect": s.names[0], "share": s.share} for s in one.screened[:SCREENED_EFFECTS]
        ],
        "judged": [
            {
                "effects": list(c.names),
                "rms": c.fit.rms,
                "held_out": c.held_out,
                "p_gain": c.p_gain,
                "p_best": c.p_best,
                "parameters": c.fit.n_parameters,
                "survives": c.names in left,
            }
            for c in one.candidates
        ],
    }


def _errors(fit: QuasiFit) -> dict[str, float]:
    return dict(zip(fit.free, fit.standard_errors.tolist(), strict=True))


def _reference(d: Diagnosis) -> dict[str, Any]:
    """The extended model by name, with what its effects were told of the data."""
    setting = setting_for(d.model, d.symptoms.series, d.base_theta)
    return {
        "name": d.model.name,
        "with": [cause.effect for cause in d.causes],
        "setting": {
            "scale": dict(setting.scale),
            "span": setting.span,
            "dt": setting.dt,
            "substeps": d.substeps,
            "time_unit": setting.time_unit,
            "later": d.later,
            "starts": d.starts,
        },
    }


def _next(d: Diagnosis) -> dict[str, Any] | None:
    """What a design of the next experiment is asked, with the model that it begins from."""
    asked = to_ask(d)
    if asked is None:
        return None
    return {**asked, "model": {**_reference(d), "with": asked.pop("with")}}


def _force(force: UnnamedForce) -> dict[str, Any]:
    return {
        "target": force.target,
        "unit": force.unit,
        "sentence": force.sentence,
        "curves": {
            "t": force.t.tolist(),
            "mean": rounded(force.mean).tolist(),
            "standard_deviation": rounded(force.sd).tolist(),
        },
    }


def _gain(gain: Gain, outputs: list[str], trusted: bool) -> dict[str, Any]:
    """Its numbers, where the squared error of the free run went, and curves on the held-out rows.

    ``budget`` splits the mean square error before into shares: ``noise`` of the measurement,
    ``left`` after the extension, and ``gone``; the three add up to 1. ``decision`` holds the ``outcome`` (see
    :class:`engine.diagnose.gain.adoption.Decision`) and why, ``in_short`` beside the numbers and ``in_full``.
    Nothing is adopted whose name is not ``trusted``.
    """
    document = {**gain.to_dict(), "adopt": gain.adopt and trusted}
    document["decision"] = {
        "outcome": gain.decision.value,
        "in_short": in_short(gain, trusted),
        "in_full": in_full(gain, trusted),
    }
    document["budget"] = [
        {
            "output": o.output,
            "noise": min(o.floor, o.rmse_after) ** 2 / o.rmse_before**2,
            "left": max(o.rmse_after**2 - o.floor**2, 0.0) / o.rmse_before**2,
            "gone": 1.0 - o.rmse_after**2 / o.rmse_before**2,
        }
        for o in gain.outputs
        if o.rmse_before > 0.0
    ]
    if len(gain.t):
        curves: dict[str, Any] = {"t": gain.t.tolist(), "measured": named(gain.y, outputs)}
        for name, run in (("before", gain.before), ("after", gain.after)):
            curves[name] = None if run is None else named(run, outputs)
        curves["log_density"] = rounded(np.nancumsum(gain.d)).tolist()
        document["curves"] = curves
    return document


def _round(found: Round) -> dict[str, Any]:
    equivalent = {r.effect.name for r in found.equivalent}
    return {
        "p_value": found.screen.p_value,
        "at_floor": found.screen.at_floor,
        "threshold": found.screen.threshold,
        "screened": [
            {
                "effect": s.effect.name,
                "title": s.effect.title,
                "statistic": s.statistic,
                "p_value": s.p_value,
            }
            for s in found.screen.scores[:SCREENED_EFFECTS]
        ],
        "refitted": [_refit(r, r.effect.name in equivalent) for r in found.refits],
        "unnamed": None
        if found.generic is None
        else {
            "effect": found.generic.effect.name,
            "gain": found.generic.gain,
            "score": found.generic.score,
        },
    }


def _refit(r: Refit, equivalent: bool) -> dict[str, Any]:
    """``equivalent`` marks the effects that the round could not tell apart."""
    return {
        "effect": r.effect.name,
        "title": r.effect.title,
        "gain": r.gain,
        "score": r.score,
        "size": r.size,
        "standard_error": r.standard_error,
        "unit": r.effect.size.unit,
        "equivalent": equivalent,
        "parameters": r.fit.theta.asdict(),
        "information": {"free": list(r.fit.free), "matrix": r.fit.information.tolist()},
    }
