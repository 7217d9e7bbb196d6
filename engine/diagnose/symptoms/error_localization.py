"""Where errors are: intervals of a signal, of time or of frequency, by mean and by size.

A signal is cut at its quantiles into bands, and every run of neighbouring bands is looked at. The
mean error in one of them is judged by its spread over simulations of the model itself,
or, for one-step predictions, by Newey and West's (1987) estimate: with d_t the errors inside, less
their mean, and zero outside, and n samples inside,

    var(mean) = (g_0 + 2 sum_{k <= L} (1 - k / (L + 1)) g_k) / n^2,   g_k = sum_t d_t d_{t-k}.

Signals must be known before the error is (predicted or simulated states and outputs, inputs, time):
where bands are cut by anything that holds the measured value, errors grow with it by themselves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from engine.distributions import chi2_sf, normal_isf
from engine.statespace.model import Array
from engine.units import SECOND, frequency_in

BANDS = 8  # of a signal or of a spectrum, in which errors are looked for
# Standard errors: by chance about one in 20 among all intervals of ten signals. Free runs get by with
# fewer, since their errors are a few slow shapes and not hundreds of independent draws.
NOTABLE, NOTABLE_RUN = 3.5, 3.0
FEWEST_SAMPLES = 5  # samples in a region
MOST_SAMPLES_SHARE = 0.6  # share of samples up to which a region is one
EXPLAINED_SHARE = 0.02  # least share of all squared errors that a notable region makes up
CENTRAL = (0.158655, 0.5, 0.841345)  # quantiles one standard deviation apart, where they are normal
ROUNDING = 64.0 * float(np.finfo(float).eps)  # a range below this much of its values is rounding


@dataclass(frozen=True)
class Region:
    """Errors of one output in one interval of a signal.

    ``mean`` +- ``standard_error``, ``rms``, and ``band`` (mean width of the predictive band) in the output's
    unit; ``score`` = mean / standard error; ``share_error`` and ``share_samples`` of all squared errors and
    samples; for frequencies ``expected_rms`` is what the model itself predicts, and ``mean`` is zero.
    """

    output: str
    kind: str  # state, input, output, time or frequency
    signal: str
    unit: str
    low: float
    high: float
    lowest: bool  # whether the interval begins where the signal does
    highest: bool
    mean: float
    standard_error: float
    score: float
    rms: float
    band: float
    share_error: float
    share_samples: float
    expected_rms: float | None = None


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors e (T,) of one output, NaN where missing; ``band`` (T,) the width of its predictive band.

    ``drawn`` (K, T) are errors that the model itself would make, None for one-step predictions.
    """

    output: str
    unit: str
    e: Array
    band: Array
    drawn: Array | None = None


def cut(signal: Array) -> Array:
    """Edges of bands with about equally many samples; fewer than two edges where it is constant."""
    finite = signal[np.isfinite(signal)]
    if finite.size < 2 or np.ptp(finite) <= ROUNDING * float(np.abs(finite).max()):
        return np.zeros(0)
    levels = np.unique(finite)
    if len(levels) <= BANDS:  # a switched signal: one band per level
        return np.concatenate([levels[:1], 0.5 * (levels[1:] + levels[:-1]), levels[-1:]])
    return np.unique(np.quantile(finite, np.linspace(0.0, 1.0, BANDS + 1)))


def by_signal(errors: Errors, kind: str, name: str, unit: str, signal: Array) -> list[Region]:
    """Every run of neighbouring bands of a signal (T,), the whole range excluded."""
    edges = cut(signal)
    n = len(edges) - 1
    if n < 2:
        return []
    seen = np.isfinite(errors.e) & np.isfinite(signal)
    band = np.clip(np.searchsorted(edges, signal, side="right") - 1, 0, n - 1)
    out = []
    for first, last in _runs(n):
        inside = seen & (band >= first) & (band <= last)
        if inside.sum() < FEWEST_SAMPLES:
            continue
        limits = (float(edges[first]), float(edges[last + 1]), first == 0, last == n - 1)
        out.append(_region(errors, seen, inside, kind, name, unit, limits))
    return out


def _region(
    errors: Errors,
    seen: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    kind: str,
    name: str,
    unit: str,
    limits: tuple[float, float, bool, bool],
) -> Region:
    e = errors.e
    mean = float(e[inside].mean())
    if errors.drawn is None:
        inner = np.where(inside, e - mean, 0.0)[seen]
        # the larger: negative correlations are often chance
        error = max(newey_west(inner, int(inside.sum()), lags) for lags in (0, None))
        score = mean / error if error > 0.0 else 0.0
    else:
        centre, error = centre_and_spread(errors.drawn[:, inside].mean(axis=1))
        score = (mean - centre) / error if error > 0.0 else 0.0
    total = float(np.sum(e[seen] ** 2))
    return Region(
        errors.output,
        kind,
        name,
        unit,
        *limits,
        mean=mean,
        standard_error=error,
        score=score,
        rms=float(np.sqrt(np.mean(e[inside] ** 2))),
        band=float(errors.band[inside].mean()),
        share_error=float(np.sum(e[inside] ** 2)) / total if total > 0.0 else 0.0,
        share_samples=float(inside.sum() / seen.sum()),
    )


def centre_and_spread(drawn: Array) -> tuple[float, float]:
    """Mean and standard deviation of simulations' values (K,) by quantiles: a few may be far off.

    Parameters are drawn with their uncertainty, to where a model is unstable or its noise has no variance.
    """
    low, middle, high = np.quantile(drawn, CENTRAL)
    return float(middle), 0.5 * float(high - low)


def newey_west(d: Array, n: int, lags: int | None = None) -> float:
    """Standard error of a mean of n values from deviations d (T,), zero where there is none."""
    L = int(4.0 * (len(d) / 100.0) ** (2.0 / 9.0)) if lags is None else lags
    variance = float(d @ d)
    for k in range(1, min(L, len(d) - 1) + 1):
        variance += 2.0 * (1.0 - k / (L + 1.0)) * float(d[k:] @ d[:-k])
    if variance <= 0.0:  # negative correlation beyond what the weights allow
        variance = float(d @ d)
    return float(np.sqrt(variance)) / max(n, 1)


def by_frequency(errors: Errors, dt: float, time_unit: str = SECOND) -> list[Region]:
    """Bands of the errors' periodogram, their edges in equal ratios from the lowest frequency.

    Missing errors count as zero. The model's own simulations tell what to expect, or, for one-step
    predictions standardised to variance one, the flat spectrum: then 2 P / E[P] ~ chi2(2 n).
    """
    T = len(errors.e)
    power, frequency = _periodogram(errors.e), np.fft.rfftfreq(T, dt)[1:]
    total = power.sum()
    if len(power) < 4 * BANDS or not total > 0.0:
        return []
    edges = np.geomspace(frequency[0], frequency[-1], BANDS + 1)
    band = np.clip(np.searchsorted(edges, frequency, side="right") - 1, 0, BANDS - 1)
    drawn = None if errors.drawn is None else np.array([_periodogram(e) for e in errors.drawn])
    seen = int(np.isfinite(errors.e).sum())
    out = []
    for k in range(BANDS):
        inside = band == k
        n = int(inside.sum())
        if n < 2:
            continue
        here = float(power[inside].sum())
        if drawn is None:
            level = seen / T * n / len(power)
            score = float(normal_isf(np.clip(chi2_sf(2 * n * here / level, 2 * n), 1e-300, 1.0)))
        else:
            tiny = float(np.finfo(float).tiny)
            logs = np.log(np.maximum(drawn[:, inside].sum(axis=1), tiny))
            centre, spread = centre_and_spread(logs)
            level = float(np.exp(centre))
            score = float(np.log(max(here, tiny)) - centre) / spread if spread > 0.0 else 0.0
        out.append(
            Region(
                errors.output,
                "frequency",
                "frequency",
                frequency_in(time_unit),
                float(edges[k]),
                float(edges[k + 1]),
                k == 0,
                k == BANDS - 1,
                mean=0.0,
                standard_error=0.0,
                score=score,
                rms=float(np.sqrt(here)),
                band=float(np.nanmean(errors.band)),
                share_error=here / float(total),
                share_samples=n / len(power),
                expected_rms=float(np.sqrt(level)),
            )
        )
    return out


def _periodogram(e: Array) -> Array:
    """Contributions of the frequencies above zero to the mean square."""
    spectrum = np.fft.rfft(np.nan_to_num(e))[1:]
    power = 2.0 * np.abs(spectrum) ** 2 / len(e) ** 2
    if len(e) % 2 == 0:
        power[-1] *= 0.5
    return np.asarray(power)


def _runs(n: int) -> Iterator[tuple[int, int]]:
    for first in range(n):
        for last in range(first, n):
            if last - first + 1 < n:
                yield first, last


def single_bands(regions: Sequence[Region]) -> list[Region]:
    """Of all runs of bands of one signal those that are one band only, in order."""
    edges = sorted({r.low for r in regions} | {r.high for r in regions})
    following = dict(pairwise(edges))
    single = [r for r in regions if following.get(r.low) == r.high]
    return sorted(single, key=lambda r: r.low)


def most_telling(regions: list[Region], limit: int, notable: float = NOTABLE) -> list[Region]:
    """The most telling notable regions first: one per signal and output, each set of samples once.

    A region that holds most samples is no region: what is wrong there is wrong throughout.
    """
    best: dict[tuple[str, str], Region] = {}
    for region in regions:
        if not abs(region.score) >= notable or region.share_samples > MOST_SAMPLES_SHARE:
            continue
        if not _matters(region):
            continue
        key = (region.output, region.signal)
        if key not in best or abs(region.score) > abs(best[key].score):
            best[key] = region
    distinct: dict[tuple[str, str, float], Region] = {}
    for region in sorted(best.values(), key=lambda r: -_explained(r)):
        same = (region.output, f"{region.rms:.9g}", region.share_samples)  # the same samples
        distinct.setdefault(same, region)
    return list(distinct.values())[:limit]


def _matters(region: Region) -> bool:
    """Whether it makes up a share of the error worth a sentence; a spectrum must exceed what is expected."""
    if region.kind == "frequency":
        expected = region.expected_rms
        if expected is None or not region.rms > 1.2 * expected:
            return False
    return _explained(region) > EXPLAINED_SHARE


def _explained(region: Region) -> float:
    """Share of all squared errors that the region's mean, or what exceeds its expectation, makes up."""
    if not region.rms > 0.0:
        return 0.0
    if region.expected_rms is not None:
        return region.share_error * (1.0 - (region.expected_rms / region.rms) ** 2)
    return region.share_error * (region.mean / region.rms) ** 2
