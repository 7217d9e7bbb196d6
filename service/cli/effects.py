"""``rbps effects``: the catalogue of what a diagnosis looks for."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from engine.diagnose import Effect, all_effects, effect_kinds
from engine.diagnose.effects.setting import Setting
from engine.models.registry import get_model, model_names
from engine.words import tidy
from service import strict_json
from service.cli.ending import wrong
from service.cli.references import model_of

WIDTH = 96


def show(model: str | None, kinds: Sequence[str], time_unit: str, as_json: bool) -> None:
    """Print the effects of a model, or every kind once, with times in ``time_unit``."""
    clock = time_unit.strip()
    if not clock:
        raise wrong("--time-unit: a unit such as s, min or year is needed")
    for kind in kinds:
        if kind not in effect_kinds():
            raise wrong(
                f"--kind {kind}: there is no such kind; kinds are {', '.join(effect_kinds())}"
            )
    found = (
        every_kind(clock)
        if model is None
        else all_effects(Setting(model_of(model), time_unit=clock))
    )
    found = [one for one in found if not kinds or one.kind in kinds]
    if as_json:
        print(strict_json.dumps([document(one) for one in found]))
        return
    for one in found:
        print("\n".join(entry(one)))
    if model is None:
        print("Those of a model, with its channels: rbps effects --model MODEL")


def every_kind(time_unit: str) -> list[Effect]:
    """Each kind as it enters the first shipped model that it can enter."""
    found: dict[str, Effect] = {}
    for name in model_names():
        for one in all_effects(Setting(get_model(name), time_unit=time_unit)):
            found.setdefault(one.kind, one)
    return [found[kind] for kind in sorted(found)]


def document(one: Effect) -> dict[str, object]:
    """An effect as JSON."""
    return {
        "name": one.name,
        "title": one.title,
        "family": one.family,
        "equation": one.equation,
        "parameters": [
            {"name": p.name, "unit": p.unit, "meaning": p.description} for p in one.parameters
        ],
        "look_alikes": one.look_alikes,
    }


def entry(one: Effect) -> Iterator[str]:
    """An effect for people."""
    yield f"{one.name}  ({one.family})"
    yield f"  {one.title[:1].upper()}{one.title[1:]}: {one.equation}"
    units = [f"{p.name}{f' [{unit}]' if (unit := tidy(p.unit)) else ''}" for p in one.parameters]
    yield from _wrapped(f"parameters: {', '.join(units)}")
    alike = [f"{kind} ({why})" if why else kind for kind, why in one.look_alikes.items()]
    if alike:
        yield from _wrapped(f"looks like: {'; '.join(alike)}")
    yield ""


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")
