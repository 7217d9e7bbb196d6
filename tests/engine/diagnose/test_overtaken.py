"""A free run's answer that one of the likelihood's beats at every horizon and with any noise is no answer."""

import numpy as np
import pytest

from engine.diagnose.free_run.second_opinion import SecondOpinion, overtaken
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.over_horizon import Candidate, OverHorizon


@pytest.mark.parametrize(
    ("errors", "gains", "better"),
    [
        ((0.85, 0.6, 0.18), (69.0, 644.0), True),
        ((0.85, 0.6, 0.245), (69.0, 644.0), False),  # no better in the free run
        ((0.85, 0.6, 0.18), (30.0, 644.0), False),  # nor with the noise of the model as given
        ((0.85, 0.6, np.nan), (69.0, 644.0), False),
    ],
)
def test_the_answer_is_overtaken_by_what_does_better_everywhere(errors, gains, better):
    rows = [
        Candidate((), (1.0, 1.0, 1.0), (0.0, 0.0)),
        Candidate(("pole:p", "path:u->y"), (0.89, 0.65, 0.24), (32.0, 605.0)),
        Candidate(("harmonic:y",), errors, gains),
    ]
    found = OverHorizon((1, 10, 480), (1.0, 0.1), tuple(rows))
    assert found.overtakes(["harmonic:y"]) == (("harmonic:y",) if better else ())
    assert found.overtakes(["step:y"]) == ()  # it is not the likelihood's


def test_where_noise_cannot_be_shared_errors_decide():
    rows = [
        Candidate((), (1.0, 1.0), (0.0,)),
        Candidate(("pole:p",), (0.9, 0.5), (np.nan,)),
        Candidate(("harmonic:y",), (0.8, 0.4), (np.nan,)),
    ]
    assert OverHorizon((1, 50), (1.0,), tuple(rows)).overtakes(["harmonic:y"])


def test_the_likelihood_decides_then_and_says_why():
    asked = SecondOpinion(
        Verdict.UNKNOWN, ("harmonic:y",), True, "The free run decides: it has names."
    )
    told = overtaken(asked, ("harmonic:y",))
    assert not told.decides
    assert told.reason.startswith("The likelihood decides: harmonic:y does better at every horizon")
