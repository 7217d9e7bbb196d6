"""Symptoms in words: "reads 0.3 V low whenever the level is above 8 V"."""

from __future__ import annotations

import math

from engine.diagnose.symptoms.compare import Fit
from engine.diagnose.symptoms.error_localization import NOTABLE, Region
from engine.words import bounds, fit_quality, number, percent, probability, with_unit


def overall(fit: Fit, what: str) -> str:
    """One line on an output of the free-run simulation or the one-step prediction."""
    how = "Free-run simulation" if what == "simulation" else "One-step prediction"
    text = f"{how} of {fit.output}: wrong by {with_unit(fit.rmse, fit.unit)} rms"
    if fit.expected_rmse is not None and fit.expected_rmse > 0.0:
        text += f" (the model expects {with_unit(fit.expected_rmse, fit.unit)}"
        if fit.as_wrong is not None:
            share = percent(fit.as_wrong) if fit.as_wrong > 0.0 else "none"
            text += f"; {share} of its own simulations are as far off"
        text += ")"
    text += f", {fit_quality(fit.fit)}"
    if math.isfinite(fit.inside):
        text += f", {percent(fit.inside)} of the readings inside its 95 % band"
    text += "."
    if fit.bias_error and abs(fit.bias) > NOTABLE * fit.bias_error:
        low_high = "low" if fit.bias > 0.0 else "high"
        size, error = (with_unit(x, fit.unit) for x in (abs(fit.bias), fit.bias_error))
        text += f" It reads {size} {low_high} on average (+- {error})."
    return text


def sentence(region: Region, what: str, unit: str) -> str:
    """Where the error is, in which direction, how large, and how much of it lies there."""
    if region.kind == "frequency":
        return _spectral(region, what, unit)
    low_high = "low" if region.mean > 0.0 else "high"  # the error is measured minus simulated
    size = with_unit(abs(region.mean), unit)
    text = (
        f"The {what} of {region.output} reads {size} {low_high} {where(region)} "
        f"(+- {with_unit(region.standard_error, unit)}"
    )
    if region.band > 0.0:
        widths = abs(region.mean) / region.band
        share = percent(widths) if widths < 2.0 else f"{number(widths, 2)} times"
        text += f", {share}{' of' if widths < 2.0 else ''} the band's width"
    error, samples = percent(region.share_error), percent(region.share_samples)
    if region.share_error < region.share_samples:
        return (
            f"{text}), though no more is wrong there than elsewhere: {error} of the squared error comes from "
            f"{samples} of the samples."
        )
    return f"{text}); {error} of the squared error comes from {samples} of the samples."


def where(region: Region) -> str:
    """``whenever level is above 8 V``; ``from 12 s to 40 s``."""
    low, high = bounds(region.low, region.high, region.unit)
    if region.kind == "time":
        if region.highest:
            return f"from t = {low} on"
        return f"up to t = {high}" if region.lowest else f"from t = {low} to {high}"
    prefix = {"state": "the state ", "input": "the input ", "output": ""}[region.kind]
    subject = f"whenever {prefix}{region.signal} is"
    if region.highest:
        return f"{subject} above {low}"
    return f"{subject} below {high}" if region.lowest else f"{subject} between {low} and {high}"


def correlated(output: str, statistic: float, lags: int, p: float) -> str:
    """That an output's standardised innovations are not white."""
    return (
        f"What the predictions of {output} miss is not random: their errors are correlated in time "
        f"(Ljung-Box {number(statistic)} over {lags} lags, {probability(p)})."
    )


def _spectral(region: Region, what: str, unit: str) -> str:
    low, high = bounds(region.low, region.high, region.unit)
    if region.lowest:
        band = f"below {high}"
    elif region.highest:
        band = f"above {low}"
    else:
        band = f"between {low} and {high}"
    expected = region.expected_rms
    times = (
        f"{number(region.rms / expected, 2)} times what the model expects there"
        if expected
        else f"{with_unit(region.rms, unit)} rms, where the model expects none"
    )
    return (
        f"The error of the {what} of {region.output} {band} is {times}; {percent(region.share_error)} "
        f"of the squared error lies in {percent(region.share_samples)} of the frequencies."
    )
