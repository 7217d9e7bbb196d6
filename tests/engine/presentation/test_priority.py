"""Which effects a report lists first."""

import engine
from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.setting import Setting
from engine.presentation.report.priority import FIRST_EFFECTS, asked_first


def test_friction_sensors_and_timing_come_first():
    names = [effect.name for effect in all_effects(Setting(engine.get_model("servo")))]
    assert len(names) > 5 * FIRST_EFFECTS
    first = asked_first(names)
    assert len(first) == len(set(first)) == FIRST_EFFECTS
    assert {"coulomb:velocity", "bias:y", "drag:velocity", "delay:drive"} <= set(first)
    assert len({name.partition(":")[0] for name in first}) == FIRST_EFFECTS  # one of each kind


def test_few_effects_are_all_listed():
    names = ["pulse:y", "bias:y2", "drag:a->b", "bias:y1", "drag:b"]
    assert asked_first(names) == ["bias:y2", "drag:b", "pulse:y", "bias:y1", "drag:a->b"]
    assert asked_first(names, 2) == ["bias:y2", "drag:b"]
    assert asked_first([]) == []
