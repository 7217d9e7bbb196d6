"""Why an extension is adopted or not, in words.

The data it was chosen on have called for it; held-out data can only speak against it. So it is refused
where it does significantly worse on them, and not where they are too few to show that it does better.
"""

from __future__ import annotations

import math

from engine.diagnose.gain import LOSS, MATTERS, Gain
from engine.words import listed, number, percent, probability


def in_short(gain: Gain) -> str:
    """A few words beside the numbers."""
    if not gain.adopt:
        return "NOT adopted: it does worse there."
    if gain.p_value <= LOSS:
        return "Adopted."
    if not math.isfinite(gain.log_density):
        return "Adopted: held-out data cannot tell."
    ahead = "not significantly worse one step ahead"
    if gain.log_density > 0.0:
        ahead = "better one step ahead, though not significantly"
    elif gain.p_loss < LOSS:
        ahead = "hardly worse one step ahead"
    better, _ = _runs(gain)
    runs = f", and better in free run of {listed(better)}" if better else ""
    return f"Adopted: {ahead}{runs}."


def in_full(gain: Gain) -> str:
    """With the rule and what it says of these numbers."""
    better, worse = _runs(gain)
    if not gain.adopt:
        return "Not adopted: the extended model does worse on these data."
    if gain.p_value <= LOSS:
        but = f", though not in free runs of {listed(worse)}" if worse else ""
        return f"Adopted: it does significantly better on data that it has not seen{but}."
    reasons = []
    if gain.log_density > 0.0:
        reasons.append(f"one step ahead its gain is within chance ({probability(gain.p_value)})")
    elif gain.p_loss < LOSS:
        reasons.append(f"one step ahead its loss is below {number(MATTERS)} in all")
    elif math.isfinite(gain.log_density):
        reasons.append(f"one step ahead its loss is within chance ({probability(gain.p_loss)})")
    gone = [
        f"{percent(1.0 - o.rmse_after / o.rmse_before)} of the error of {o.output}"
        for o in gain.outputs
        if o.output in better
    ]
    if gone:
        reasons.append(f"in free run {listed(gone)} {'is' if len(gone) == 1 else 'are'} gone")
    because = f" Here it does not: {listed(reasons)}." if reasons else ""
    return (
        "Adopted. The data it was found on call for it; held-out data refuse it only where it does "
        f"significantly worse on them.{because}"
    )


def _runs(gain: Gain) -> tuple[list[str], list[str]]:
    """Outputs whose free run is significantly better, and those where it is significantly worse."""
    better = [o.output for o in gain.outputs if o.interval_difference[1] < 0.0]
    worse = [o.output for o in gain.outputs if o.interval_difference[0] > 0.0]
    return better, worse
