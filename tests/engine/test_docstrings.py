"""Public functions list their arguments, what they return and what they raise (numpydoc)."""

import inspect
import re

import pytest

import engine

FUNCTIONS = [name for name in engine.__all__ if inspect.isfunction(getattr(engine, name))]


def sections(function):
    """{title: the lines below it} of a function's docstring."""
    parts = re.split(r"\n([A-Z][a-z]+)\n-+\n", inspect.getdoc(function))
    return dict(zip(parts[1::2], (part.splitlines() for part in parts[2::2]), strict=True))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_are_those_of_the_signature(name):
    function = getattr(engine, name)
    entries = [line for line in sections(function).get("Parameters", ()) if line[:1].strip()]
    assert all(re.fullmatch(r"\w+ : .+", entry) for entry in entries)
    assert [entry.split()[0] for entry in entries] == list(inspect.signature(function).parameters)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_argument_and_result_is_described(name):
    function = getattr(engine, name)
    found = sections(function)
    assert ("Returns" in found) == (inspect.signature(function).return_annotation != "None")
    for lines in found.values():
        for entry, below in zip(lines, [*lines[1:], ""], strict=True):
            if entry[:1].strip():
                assert below.startswith("    "), entry
