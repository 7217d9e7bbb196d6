"""When something seems to have begun and ended: the windows of a record in which a disturbance promises most.

A disturbance that is the same from one sample to another scores the sum of what it scores at each
(:mod:`engine.diagnose.screening.disturbances`); its information is that of footprints, known for a few windows
of every length and taken for the others in proportion to the information of their samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from engine.statespace.model import Array

SHORTEST = 2  # samples; what lasts for one is a pulse
LONGEST = 0.8  # of the record; a step is found once, and can be taken back by an episode alone
GROWTH = 1.3  # from one length to the next
KNOWN = 6  # windows of a length whose information is found
TRIED = 60  # windows tested exactly
NEAR = 3  # places to either side at which an end is tried again, spread over a share ...
SHARE = 0.25  # ... of the length, then of what lies between them, until they are rows

Window = tuple[int, int]  # from one sample to before another
Information = Callable[[Sequence[Window]], Array]


def lengths(n: int) -> list[int]:
    """Samples that a window may have, of a record of ``n``."""
    out, most = [SHORTEST], int(LONGEST * n)
    while out[-1] * GROWTH < most:
        out.append(max(out[-1] + 1, round(out[-1] * GROWTH)))
    return [w for w in out if w <= most]


def tries(n: int) -> float:
    """How many independent places the windows of all lengths amount to.

    Where the scores of windows that overlap fall off linearly, as they do, their maximum of u standard
    deviations is that of some n u^2 / w windows (Pickands 1969); of two lengths next to each other half is new.
    """
    usual = 16.0  # u^2 of what is found
    return sum(0.5 * n * min(1.0, usual / w) for w in lengths(n))


def promising(
    scores: Array, information: Array, breaks: Sequence[int], known: Information
) -> list[Window]:
    """The windows that promise most, a few of each length, none over one of the ``breaks``.

    ``scores`` and ``information`` (n,) are those of each sample; ``known`` gives that of windows.
    """
    n, edge = len(scores), 2
    sums, added = (np.concatenate([[0.0], np.cumsum(x)]) for x in (scores, information))
    found: list[tuple[float, Window]] = []
    every = lengths(n)
    for w in every:
        first = np.arange(edge, n - w - edge + 1)
        first = first[[not any(i < b < i + w for b in breaks) for i in first]]
        own = added[first + w] - added[first]
        first, own = first[own > 0.0], own[own > 0.0]
        if not first.size:
            continue
        some = first[np.linspace(0, len(first) - 1, KNOWN).astype(int)]
        exact = known([(int(i), int(i) + w) for i in some])
        ratio = float(np.median(exact / (added[some + w] - added[some])))
        if not ratio > 0.0:
            continue
        promise = (sums[first + w] - sums[first]) ** 2 / (ratio * own)
        each = max(1, TRIED // len(every))
        found += [
            (float(promise[k]), (int(first[k]), int(first[k]) + w))
            for k in _peaks(promise, w, each)
        ]
    return [window for _, window in sorted(found, reverse=True)[:TRIED]]


def _peaks(promise: Array, apart: int, most: int) -> list[int]:
    """Places of the largest values, each as far apart from the others as a window is long."""
    out: list[int] = []
    for k in np.argsort(-promise):
        if all(abs(int(k) - other) >= apart for other in out):
            out.append(int(k))
        if len(out) == most:
            break
    return out


def strides(window: Window) -> list[float]:
    """Samples from one place at which an end is tried to the next, ever fewer, in the end one."""
    begin, end = window
    out = [max(1.0, SHARE * (end - begin) / NEAR)]
    while out[-1] > 1.0:
        out.append(max(1.0, out[-1] / NEAR))
    return out


def near(window: Window, n: int, stride: float) -> list[Window]:
    """The window with its ends moved a little: by a few times so many samples."""
    begin, end = window
    by = sorted({round(k * stride) for k in range(-NEAR, NEAR + 1)})
    return [
        (begin + i, end + j)
        for i in by
        for j in by
        if begin + i >= 0 and end + j < n and end + j - begin - i >= SHORTEST
    ]
