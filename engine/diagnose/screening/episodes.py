"""When something seems to have begun and ended: the windows of a record in which a disturbance promises most.

A disturbance that is the same from one sample to another scores the sum of what it scores at each
(:mod:`engine.diagnose.screening.disturbances`); its information is that of footprints, known for a few windows
of every length and taken for the others in proportion to the information of their samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from engine.statespace.model import Array

SHORTEST = 2  # samples; what lasts for one is a pulse
LONGEST = 0.8  # of the record; a step is found once, and can be taken back by an episode alone
GROWTH = 1.3  # from one length whose information is known to the next
PAIRS = 2e6  # of beginnings and ends looked at, at most
KNOWN = 6  # windows of a length whose information is found
TRIED = 60  # windows tested exactly
USUAL = 16.0  # squared standard deviations of what is found
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


def promising(
    scores: Array, information: Array, breaks: Sequence[int], known: Information
) -> tuple[list[Window], float]:
    """The windows that promise most, a few of each length, none over one of the ``breaks``.

    ``scores`` and ``information`` (n,) are those of each sample; ``known`` gives that of windows. Of a good
    sensor only a window with both of its ends right promises anything: all lengths are looked at, not only
    those whose information is known.

    Then how many independent windows that amounts to. One sample more at an end, of information p, leaves a
    correlation of 1 - p / 2 I of windows with information I. Then of those that overlap a share of
    u^2 p / 2 I is new at each end, u standard deviations being found (Pickands 1969).
    """
    n, edge = len(scores), 2
    sums, added = (np.concatenate([[0.0], np.cumsum(x)]) for x in (scores, information))
    found: list[tuple[float, Window]] = []
    every = lengths(n)
    each = max(1, TRIED // max(len(every), 1))
    one = float(np.median(information[information > 0.0])) if (information > 0.0).any() else 0.0
    new = 0.0
    for w, longer in pairwise([*every, int(LONGEST * n) + 1]):
        first = _within(np.arange(edge, n - w - edge + 1), w, breaks)
        first = first[added[first + w] > added[first]]
        if not first.size:
            continue
        some = first[np.linspace(0, len(first) - 1, KNOWN).astype(int)]
        exact = known([(int(i), int(i) + w) for i in some])
        ratio = float(np.median(exact / (added[some + w] - added[some])))
        if not ratio > 0.0:
            continue
        new += 0.5 * n * min(1.0, 0.5 * USUAL * one / float(np.median(exact))) ** 2 * (longer - w)
        promise, length = np.zeros(n), np.full(n, w)
        few = max(1, int(PAIRS / (n * len(every))))
        for v in np.unique(np.linspace(w, longer - 1, min(longer - w, few)).astype(int)):
            first = _within(np.arange(edge, n - v - edge + 1), v, breaks)
            own = added[first + v] - added[first]
            first, own = first[own > 0.0], own[own > 0.0]
            here = (sums[first + v] - sums[first]) ** 2 / (ratio * own)
            better = here > promise[first]
            promise[first[better]], length[first[better]] = here[better], v
        found += [(float(promise[k]), (k, k + int(length[k]))) for k in _peaks(promise, w, each)]
    return [window for _, window in sorted(found, reverse=True)[:TRIED]], new


def _within(first: NDArray[np.intp], w: int, breaks: Sequence[int]) -> NDArray[np.intp]:
    """Of windows of ``w`` samples those that hold none of the ``breaks``, by where they begin."""
    for b in breaks:
        first = first[(first >= b) | (first + w <= b)]
    return first


def _peaks(promise: Array, apart: int, most: int) -> list[int]:
    """Places of the largest values above 0, each as far apart from the others as a window is long."""
    out: list[int] = []
    for k in np.argsort(-promise)[: np.count_nonzero(promise)]:
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
