"""Public names list their arguments, what they return, hold and raise (numpydoc)."""

import dataclasses
import inspect
import re

import pytest

import engine

FUNCTIONS = [name for name in engine.__all__ if inspect.isfunction(getattr(engine, name))]
RECORDS = [name for name in engine.__all__ if dataclasses.is_dataclass(getattr(engine, name))]


def sections(described):
    """{title: the lines below it} of a docstring."""
    parts = re.split(r"\n([A-Z][a-z]+)\n-+\n", inspect.getdoc(described))
    return dict(zip(parts[1::2], (part.splitlines() for part in parts[2::2]), strict=True))


def check_entries(found):
    for title in found.keys() - {"Examples"}:
        lines = found[title]
        for entry, below in zip(lines, [*lines[1:], ""], strict=True):
            if entry[:1].strip():
                assert below.startswith("    "), entry


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_are_those_of_the_signature(name):
    function = getattr(engine, name)
    entries = [line for line in sections(function).get("Parameters", ()) if line[:1].strip()]
    assert all(re.fullmatch(r"\w+ : .+|\*\*\w+", entry) for entry in entries)
    arguments = inspect.signature(function).parameters
    assert [entry.split()[0].strip("*") for entry in entries] == list(arguments)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_argument_and_result_is_described(name):
    function = getattr(engine, name)
    found = sections(function)
    assert ("Returns" in found) == (inspect.signature(function).return_annotation != "None")
    check_entries(found)


@pytest.mark.parametrize("name", RECORDS)
def test_what_a_record_holds_is_described(name):
    record = getattr(engine, name)
    found = sections(record)
    entries = [
        line for lines in map(found.get, ("Parameters", "Attributes")) for line in lines or ()
    ]
    described = [entry.split(" : ")[0].split(", ") for entry in entries if entry[:1].strip()]
    arguments = list(inspect.signature(record).parameters)
    assert sorted(argument for names in described for argument in names) == sorted(arguments)
    check_entries(found)
