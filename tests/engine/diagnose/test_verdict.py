"""When several effects found in turn are trusted, and when they are patches on something else."""

from types import SimpleNamespace

import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.search.refits import Refit
from engine.diagnose.search.rounds import Round
from engine.diagnose.search.search import Search
from engine.diagnose.search.verdict import patchwork, verdict_of
from tests.engine.hidden_effects import DRIVE

DRAG, BIAS, STEP = "drag:speed", "bias:reading", "step:reading"
FORCE = "latent:speed"
LEVEL, OUTLIERS = "level:reading", "heavy-tails:reading"


def searched(*names, left=0.6, alarm=False, unnamed=None):
    """A search that found effects in turn, the last screen's p-value being ``left``.

    Each has a score of 50; the unnamed force has ``unnamed``.
    """
    generic = None
    if unnamed is not None:
        generic = Refit(make_effect(FORCE, Setting(DRIVE)), None, unnamed, unnamed)
    rounds = []
    for name in names:
        refit = Refit(make_effect(name, Setting(DRIVE)), None, 50.0, 50.0)
        rounds.append(Round(SimpleNamespace(p_value=0.002), (refit,), generic, (refit,)))
    rounds.append(Round(SimpleNamespace(p_value=left), (), None, ()))
    return Search(None, None, tuple(rounds), alarm)


@pytest.mark.parametrize(
    ("names", "left", "verdict"),
    [
        ([], 0.6, "nothing"),
        ([DRAG], 0.6, "named"),
        ([DRAG], 0.02, "named"),
        ([LEVEL], 0.6, "named"),
        ([LEVEL], 0.02, "named"),  # one true noise in fifty has as much left
        ([LEVEL], 0.008, "unknown"),
        ([DRAG, BIAS], 0.6, "named"),
        ([DRAG, BIAS], 0.008, "unknown"),  # quiet enough to stop, not to be sure of both
        ([DRAG, LEVEL], 0.6, "unknown"),  # the rest of what drag explains in part
        ([DRAG, BIAS, STEP], 0.6, "unknown"),
        ([OUTLIERS, STEP], 0.6, "named"),  # outliers had hidden the step
        ([OUTLIERS, STEP, BIAS], 0.6, "named"),
    ],
)
def test_more_than_two_effects_or_noise_beside_another_are_not_trusted(names, left, verdict):
    search = searched(*names, left=left)
    assert verdict_of(search, alpha=0.05).value == verdict
    assert patchwork(search, 0.05) == (verdict == "unknown")


def test_an_alarm_that_nothing_explains_is_unknown():
    assert verdict_of(searched(DRAG, alarm=True), alpha=0.05).value == "unknown"
    assert verdict_of(searched(alarm=True), alpha=0.05).value == "unknown"


@pytest.mark.parametrize(
    ("unnamed", "verdict"), [(40.0, "named"), (46.0, "set"), (51.0, "unknown")]
)
def test_a_name_must_clearly_beat_the_unnamed_force(unnamed, verdict):
    assert verdict_of(searched(DRAG, unnamed=unnamed), alpha=0.05).value == verdict
