"""``rbps models``: what there is to estimate."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator, Sequence

from engine.diagnose.effects.catalogue import all_effects
from engine.diagnose.effects.setting import Setting
from engine.models.registry import get_model, model_names, plugin_errors
from engine.presentation.model_check import model_check
from engine.statespace.model import MixedModel
from engine.words import number, tidy
from service import strict_json
from service.cli.references import model_of, with_effects
from service.serializers import members


def show_all(as_json: bool) -> None:
    """Every registered model with its description; broken plug-ins on stderr."""
    models = [get_model(name) for name in model_names()]
    if as_json:
        print(strict_json.dumps([members(model) for model in models]))
    else:
        width = max(len(model.name) for model in models) + 2
        for model in models:
            print(f"{model.name:<{width}}{model.description}")
        print(
            "\nOne of them: rbps models NAME. Your own: path/to/file.py:name; 'rbps new FILE.py' writes one"
        )
    for plugin, error in plugin_errors().items():
        print(f"rbps: the plug-in '{plugin}' could not be loaded: {error}", file=sys.stderr)


def show_one(reference: str, effects: Sequence[str], list_effects: bool, as_json: bool) -> None:
    """One model in full, or what can be added to it."""
    model = with_effects(model_of(reference), effects, [])
    if list_effects:
        found = all_effects(Setting(model))
        if as_json:
            keys = ("name", "title", "family", "equation")
            out = [
                {key: getattr(one, key) for key in keys} | {"parameter": one.size.name}
                for one in found
            ]
            print(strict_json.dumps(out))
            return
        width = max(len(one.name) for one in found) + 2
        for one in found:
            print(f"{one.name:<{width}}{one.title}: {one.equation}")
    elif as_json:
        print(strict_json.dumps(members(model)))
    else:
        print("\n".join(page(model)))


def page(model: MixedModel) -> Iterator[str]:
    """The model for people."""
    yield model.name
    if model.description:
        yield f"  {model.description}"
    if model.equations:
        yield "\nEquations"
        yield from (f"  {line}" for line in model.equations)
    for title, channels in (
        ("Nonlinear states", model.nonlinear),
        ("Linear states", model.linear),
        ("Inputs", model.inputs),
        ("Outputs", model.outputs),
    ):
        if channels:
            yield f"\n{title}"
            yield from (f"  {name:<16}{tidy(unit)}".rstrip() for name, unit in channels.items())
    yield f"\n{'Parameters':<18}{'default':>10}  {'bounds':<22}{'unit':<14}meaning"
    for p in model.parameters:
        bounds = f"[{number(p.bounds[0])}, {number(p.bounds[1])}]"
        text = f"  {p.name:<16}{number(p.default, 5):>10}  {bounds:<22}{tidy(p.unit):<14}"
        yield f"{text}{p.description}".rstrip()
    yield "\nWhat its check says"
    for sentence in model_check(model):
        yield from textwrap.wrap(sentence, 96, initial_indent="  ", subsequent_indent="    ")
