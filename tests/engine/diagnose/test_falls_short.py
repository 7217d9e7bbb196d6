"""Held-out data that contradict what the search gained."""

from dataclasses import replace

import pytest

from engine.diagnose.gain.adoption import Decision, falls_short
from engine.diagnose.gain.gain import Gain

LOSS = Gain(
    how="held-out rows",
    samples=100,
    log_density=-20.0,
    per_sample=-0.2,
    standard_error=0.08,  # 8 nats in all
    p_value=0.99,
    p_loss=0.01,
    outputs=(),
    decision=Decision.NO_EVIDENCE,
)


def test_a_loss_where_a_gain_was_promised_contradicts():
    said = falls_short(LOSS, 10.0)
    assert "loses 20 in log-density" in said
    assert "10 were to be gained" in said


@pytest.mark.parametrize(
    ("gain", "promised"),
    [
        (LOSS, 0.0),  # nothing was promised
        (replace(LOSS, log_density=-0.5, per_sample=-0.005), 30.0),  # as good as no loss
        (replace(LOSS, log_density=-5.0, per_sample=-0.05, standard_error=0.5), 10.0),  # by chance
        (replace(LOSS, decision=Decision.ADOPTED), 10.0),  # its free run is better
        (replace(LOSS, log_density=float("nan")), 10.0),
    ],
)
def test_other_losses_do_not(gain, promised):
    assert falls_short(gain, promised) == ""
