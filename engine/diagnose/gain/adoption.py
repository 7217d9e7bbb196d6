"""Whether held-out data call for an extension, and why, in words.

The data that an extension was chosen on cannot speak for it a second time. It is adopted where data that it
has not seen show that it does better, one step ahead or in the free run of an output, and where they show no
significant loss in either; nor, where it is for one free run alone, any loss in both. Without such evidence
the cause is named and the model stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import TYPE_CHECKING

from engine.diagnose.gain.simulation_gain import OutputGain
from engine.diagnose.records import FEWEST_ROWS
from engine.distributions import student_sf
from engine.words import enumerated, number, percent, probability, with_unit

if TYPE_CHECKING:
    from engine.diagnose.gain.gain import Gain

TEST_LEVEL = 0.05  # of the one-sided tests of a gain and of a loss one step ahead
TELLING_ROWS = 16  # held out, from which on what they lose may contradict a name
LOSS_NATS = 1.0  # nats in all: a smaller loss, a likelihood ratio below e, speaks against nothing
NOT_MEASURED = (
    "Nothing was held out: what the extension gains on other data was not measured "
    "(held_out=, or test=)."
)
TELLING_FIT = 10.0  # % of fit: a free run below it is hardly better than a constant, and a loss ...
TELLING_LOSS = 1.25  # ... contradicts nothing unless its error grows by this factor
RAN_AWAY = -200.0  # % of fit: an error of three standard deviations of the readings
RUN_SHARE = 0.01  # of a free run's rms error: a smaller change, however sure, is none


class Decision(Enum):
    """What held-out data say of an extension; ``value`` is the word used at every edge."""

    ADOPTED = "adopted"
    NO_EVIDENCE = "no evidence"
    LOSES = "loses"


def decide(
    p_gain: float,
    p_loss: float,
    log_density: float,
    outputs: Sequence[OutputGain],
    lost: bool = False,
) -> Decision:
    """The decision from the one-sided p-values of the log-density gained in all, and from the free runs.

    ``lost``: the extended model's filter or free run is lost on the held-out data where the model as
    given is not.
    """
    better, worse = runs_changed(outputs)
    if lost or worse or _predicts_worse(p_loss, log_density):
        return Decision.LOSES
    adopted = p_gain <= TEST_LEVEL or (better and not _set_back(log_density, outputs))
    return Decision.ADOPTED if adopted else Decision.NO_EVIDENCE


def falls_short(gain: Gain, expected: float, noise: str = "") -> str:
    """A sentence where the log-density lost on held-out data contradicts what was to be gained there.

    ``expected`` nats are what the likelihood gained in the search promises for so many rows. An effect that
    the held-out data do not excite gains nothing there and loses nothing; one that stands in for something
    else loses. Where it is significantly worse one step ahead and in the free run nothing need be expected, as
    of a step that was gone again. What is adopted for its free run is not contradicted, and nothing by a few
    rows, whose scatter is not known. ``noise`` says how that was fitted, where otherwise than for the gain
    that is shown.
    """
    if gain.adopt or gain.samples < TELLING_ROWS:
        return ""
    worse = runs_changed(gain.outputs)[1]
    if worse and _predicts_worse(gain.p_loss, gain.log_density):
        return (
            f"On data that it has not seen the extension predicts worse, by {number(-gain.log_density)} in "
            f"log-density{noise} ({probability(gain.p_loss)} of no loss), and simulates {_names(worse)} "
            "worse: it stands in for something else, so no cause is named."
        )
    error = gain.standard_error * gain.samples
    if not (math.isfinite(gain.log_density) and gain.log_density < -LOSS_NATS and error > 0.0):
        return ""
    p_value = student_sf((expected - gain.log_density) / error, max(gain.samples - 1, 1))
    if not (expected > 0.0 and p_value < TEST_LEVEL):
        return ""
    return (
        f"On data that it has not seen the extension loses {number(-gain.log_density)} in log-density{noise}, "
        f"where {number(expected)} were to be gained ({probability(p_value)} of so little): it stands in for "
        "something else, so no cause is named."
    )


def runs_worse(gain: Gain, others: Sequence[str], noises: Sequence[str]) -> str:
    """A sentence where ``others``, named beside ``noises`` or by themselves, make the free run worse; else "".

    Noise moves no free run, and what is gained one step ahead may be all its own. So the free run is what
    speaks of the others. Without noise, too, a gain one step ahead alone does not speak for them: a wave that
    follows a reading from row to row leads the states astray. There the run of another output may.
    """
    better, worse = runs_changed(gain.outputs)
    if not (others and worse) or (better and not noises) or gain.samples < TELLING_ROWS:
        return ""
    stand = "stands" if len(others) == 1 else "stand"
    by = f"by {enumerated([*noises])}, and" if noises else "from row to row alone:"
    return (
        f"On data that it has not seen the extension simulates {_names(worse)} worse: "
        f"{enumerated(_runs(worse))}. What it predicts better may be {by} "
        f"{enumerated([*others])} {stand} in for something else"
        f"{': no' if noises else ', so no'} cause is named."
    )


def nothing_better(gain: Gain) -> bool:
    """Whether held-out data that could tell show nothing of an extension better, surely or not.

    Neither its predictions nor any free run: where the predictions lose less than a nat, every free run must be
    worse by more than a trifle.
    """
    if gain.adopt or gain.samples < TELLING_ROWS or not gain.log_density <= 0.0:
        return False
    if gain.log_density < -LOSS_NATS:
        return all(o.difference >= 0.0 for o in gain.outputs)
    return bool(gain.outputs) and all(
        o.difference > RUN_SHARE * o.rmse_before for o in gain.outputs
    )


def _predicts_worse(p_loss: float, log_density: float) -> bool:
    """Whether the predictions one step ahead are significantly worse."""
    return p_loss < TEST_LEVEL and log_density < -LOSS_NATS


def _set_back(log_density: float, outputs: Sequence[OutputGain]) -> list[OutputGain]:
    """Outputs whose free run is further off, surely or not, where the predictions are not better either.

    What one sensor gains tells little beside them: an extension may bend one free run at the cost of others.
    """
    if not log_density < -LOSS_NATS:
        return []
    better = runs_changed(outputs)[0]
    further = [o for o in outputs if o.difference > RUN_SHARE * o.rmse_before and not ran_away(o)]
    return [o for o in further if o not in better and _tells(o, len(outputs))]


def runs_changed(outputs: Sequence[OutputGain]) -> tuple[list[OutputGain], list[OutputGain]]:
    """Outputs whose free run is significantly better, and those where it is significantly worse.

    A run that was hardly better than a constant, as that of a model whose states are driven by noise, is no
    worse for being a little further off; nor is one that by the extended model's own noise would often be.
    """
    better, worse = _changed(outputs)
    return better, [o for o in worse if _tells(o, len(outputs))]


def _changed(outputs: Sequence[OutputGain]) -> tuple[list[OutputGain], list[OutputGain]]:
    changed = [
        o for o in outputs if abs(o.difference) > RUN_SHARE * o.rmse_before and not ran_away(o)
    ]
    better = [o for o in changed if o.interval_difference[1] < 0.0]
    return better, [o for o in changed if o.interval_difference[0] > 0.0]


def ran_away(o: OutputGain) -> bool:
    """Whether both free runs are so far off that they tell nothing, as those of an unstable plant are."""
    return o.fit_before < RAN_AWAY and o.fit_after < RAN_AWAY


def _tells(o: OutputGain, n: int) -> bool:
    """Whether a free run that is worse, one of ``n``, says something."""
    far = not o.fit_before < TELLING_FIT or o.rmse_after > TELLING_LOSS * o.rmse_before
    return far and not _by_noise(o, n)


def _by_noise(o: OutputGain, n: int) -> bool:
    """Whether one of ``n`` outputs is worse by no more than noise makes one of them: each is a chance."""
    return o.as_worse is not None and o.as_worse > TEST_LEVEL / n


def in_short(gain: Gain, named: bool = True) -> str:
    """A few words beside the numbers; not ``named`` is an extension whose cause is unknown."""
    if gain.decision is Decision.LOSES:
        return "NOT adopted: it does worse there."
    if gain.decision is Decision.NO_EVIDENCE:
        return "NOT adopted: no evidence there that it does better."
    better = f"better in free run of {_names(runs_changed(gain.outputs)[0])}"
    if not named:
        what = "gain" if gain.p_value <= TEST_LEVEL else f"be {better}"
        return f"NOT adopted, though it would {what}: no cause is named."
    return "Adopted." if gain.p_value <= TEST_LEVEL else f"Adopted: {better}."


def in_full(gain: Gain, named: bool = True) -> str:
    """One sentence with the reason; not ``named`` is an extension whose cause is unknown."""
    if gain.decision is Decision.LOSES:
        better = _names(runs_changed(gain.outputs)[0])
        but = f"; its free run of {better} is better" if better else ""
        return f"Not adopted, as it loses on data that it has not seen: {enumerated(_losses(gain))}{but}."
    if gain.decision is Decision.NO_EVIDENCE:
        if gain.samples < FEWEST_ROWS:
            return (
                f"Not adopted for want of evidence: {gain.samples} rows are held out, and fewer than "
                f"{FEWEST_ROWS} tell nothing. Give more of them (held_out=), or other records (test=)."
            )
        runs = "no free run is significantly better"
        if gained := runs_changed(gain.outputs)[0]:
            back = _names(_set_back(gain.log_density, gain.outputs))
            runs = f"its free run of {_names(gained)} is better but that of {back} is worse"
        return (
            "Not adopted for want of evidence: on data that it has not seen, "
            f"{_one_step(gain)}, and {runs}."
        )
    predicts = gain.p_value <= TEST_LEVEL
    reasons = [f"one step ahead ({probability(gain.p_value)})"] if predicts else []
    reasons += [
        f"in free run of {o.output} ({percent(1.0 - o.rmse_after / o.rmse_before)} of the error gone)"
        for o in runs_changed(gain.outputs)[0]
    ]
    but = "" if predicts else f"; {_one_step(gain)}"
    n = len(gain.outputs)
    aside = [o for o in _changed(gain.outputs)[1] if not _tells(o, n)]
    noise = [o for o in aside if _by_noise(o, n)]
    constant = [o for o in aside if o not in noise]
    if noise:
        but += f"; {enumerated(_runs(noise))}, as noise alone would often have it"
    if constant:
        but += f"; {enumerated(_runs(constant))}, but it was hardly better than a constant before"
    taken = "Adopted" if named else "Not adopted, as no cause is named"
    return f"{taken}: on data that it has not seen it does significantly better {enumerated(reasons)}{but}."


def _one_step(gain: Gain) -> str:
    if not math.isfinite(gain.log_density):
        return "nothing can be said of its predictions one step ahead"
    if gain.log_density > 0.0:
        return f"its gain one step ahead is within chance ({probability(gain.p_value)})"
    if gain.p_loss < TEST_LEVEL:
        return f"its loss one step ahead is below {number(LOSS_NATS)} in all"
    return f"its loss one step ahead is within chance ({probability(gain.p_loss)})"


def not_beside(last: Sequence[str], named: Sequence[str], gain: Gain) -> str:
    """Why what was found ``last`` beside others is left out: they do worse with it on held-out data."""
    return (
        f"Beside {enumerated([*named])} the free run also finds {enumerated([*last])}, which is left out: with "
        f"it the extension does worse on data that it has not seen, as {_all_losses(gain)}."
    )


def in_its_place(first: Sequence[str], then: Sequence[str], gain: Gain) -> str:
    """Why what the free run had chosen ``first`` is not said, but what stands for it ``then``."""
    return (
        f"Rows left out do not tell {enumerated([*first])} from {enumerated([*then])} in free run, data that "
        f"neither has seen do: with the former {_all_losses(gain)}."
    )


def _all_losses(gain: Gain) -> str:
    """What is worse with an extension, surely or not."""
    worse = _runs([o for o in gain.outputs if o.difference > 0.0])
    if gain.log_density < 0.0:
        worse.append(f"its log-density one step ahead is lower by {number(-gain.log_density)}")
    return enumerated(worse or ["its filter or its free run is lost there"])


def _losses(gain: Gain) -> list[str]:
    out = []
    if _predicts_worse(gain.p_loss, gain.log_density):
        out.append(
            f"its log-density one step ahead is lower by {number(-gain.log_density)} "
            f"({probability(gain.p_loss)} of no loss)"
        )
    out += _runs(runs_changed(gain.outputs)[1])
    return out or ["its filter or its free run is lost there"]


def _runs(outputs: Sequence[OutputGain]) -> list[str]:
    """How much worse each free run is."""
    return [
        f"its free run of {o.output} is wrong by {with_unit(o.rmse_after, o.unit)} rms instead of "
        f"{number(o.rmse_before)}"
        for o in outputs
    ]


def _names(outputs: Sequence[OutputGain]) -> str:
    return enumerated([o.output for o in outputs])
