"""What the options of names and numbers stand for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from engine.errors import EngineError
from engine.statespace.model import MixedModel, Theta
from service.cli.ending import wrong


def pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """``["a=1", "b=2"]`` as a dict."""
    out = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (equals and name.strip() and value.strip()):
            raise wrong(f"{option} {text}: NAME=VALUE is needed")
        if name.strip() in out:
            raise wrong(f"{option} {text}: {name.strip()} is given twice; leave one of them out")
        out[name.strip()] = value.strip()
    return out


def numbers(option: str, texts: Sequence[str]) -> dict[str, float]:
    """The same with numbers for values."""
    out = {}
    for name, value in pairs(option, texts).items():
        try:
            out[name] = float(value)
        except ValueError:
            raise wrong(f"{option} {name}={value}: '{value}' is not a number") from None
    return out


def names(texts: Sequence[str]) -> list[str]:
    """``["a,b", "c"]`` as a list of names."""
    return [name.strip() for text in texts for name in text.split(",") if name.strip()]


@contextmanager
def about(option: str) -> Iterator[None]:
    """Errors of the engine in here are the user's, about an option."""
    try:
        yield
    except EngineError as error:
        raise wrong(f"{option}: {error}") from None


def theta_of(model: MixedModel, values: dict[str, float], fixed: dict[str, float]) -> Theta:
    """Start values: the defaults, ``--set`` and ``--fix``."""
    with about("--set"):
        model.theta(values)
    with about("--fix"):
        return model.theta(values | fixed)


def free_of(model: MixedModel, free: list[str], fixed: Sequence[str]) -> list[str] | None:
    """Names of the parameters to estimate; None for all."""
    with about("--free"):
        model.free_indices(free)
    both = [name for name in free if name in fixed]
    if both:
        raise wrong(f"--free {both[0]}: it is also given with --fix; choose one")
    if not free and not fixed:
        return None
    left = [name for name in free or model.parameter_names if name not in fixed]
    if not left:
        raise wrong("--fix: no parameter is left to estimate")
    return left


def one_of(option: str, value: str, choices: Sequence[str]) -> str:
    """The value if it is one of the choices."""
    if value not in choices:
        raise wrong(f"{option} {value}: choose one of {', '.join(choices)}")
    return value
