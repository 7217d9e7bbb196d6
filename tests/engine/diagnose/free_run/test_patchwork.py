"""More effects in free run than are trusted are patches on a cause without a name."""

from itertools import pairwise
from types import SimpleNamespace as Some

import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import FreeRunSearch
from tests.engine.hidden_effects import DRIVE

DRAG, OFFSET = "drag:speed", "input-offset:force"
CUBIC, SENSOR, STEPS = "cubic:speed", "gain:reading", "time-step:dt"


def searched(*rounds, errors, size=1.3):
    """A search whose rounds add these effects, with the free run's error before each and after the last."""
    after = Some(theta={"time_step_dt": size})
    done = []
    for names, rms in zip((*rounds, ()), errors, strict=True):
        added = tuple(make_effect(name, Setting(DRIVE)) for name in names)
        chosen = Some(fit=None, added=added) if names else None
        done.append(Some(chosen=chosen, survivors=((),), alarmed=True, fit=Some(rms=rms)))
    for one, then in pairwise(done):
        one.chosen.fit = then.fit
    return FreeRunSearch(tuple(done), (None, after), (0.0,))


@pytest.mark.parametrize(
    ("rounds", "errors", "verdict"),
    [
        ([[DRAG, OFFSET]], [1.0, 0.3], "named"),
        ([[DRAG, OFFSET], [CUBIC]], [1.0, 0.3, 0.2], "named"),
        ([[DRAG], [OFFSET], [CUBIC]], [1.0, 0.5, 0.3, 0.2], "named"),
        ([[DRAG, SENSOR], [OFFSET, CUBIC]], [1.0, 0.3, 0.2], "unknown"),
        (
            [[DRAG, STEPS], [OFFSET, CUBIC]],
            [1.0, 0.3, 0.2],
            "named",
        ),  # the steps' error is there anyway
    ],
)
def test_more_than_three_effects_are_not_trusted(rounds, errors, verdict):
    found = searched(*rounds, errors=errors)
    assert found.verdict.value == verdict
    assert found.is_patchwork == (verdict == "unknown")
