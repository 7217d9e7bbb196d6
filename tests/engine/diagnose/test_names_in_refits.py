"""What a row of the table over the horizon holds, once the effects of several rounds were weighed together."""

from types import SimpleNamespace

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.over_horizon import names_in
from tests.engine.hidden_effects import DRIVE


def test_a_refit_beside_other_effects_is_named_by_all_of_them():
    drag, bias, step = (
        make_effect(name, Setting(DRIVE)) for name in ("drag:speed", "bias:reading", "step:speed")
    )
    alone = SimpleNamespace(effect=drag, fit=SimpleNamespace(model=drag.apply(DRIVE)))
    assert names_in(alone, [drag, bias]) == ("drag:speed",)
    both = bias.apply(step.apply(DRIVE))
    beside = SimpleNamespace(effect=step, fit=SimpleNamespace(model=both))
    assert names_in(beside, [drag, bias]) == ("step:speed", "bias:reading")
