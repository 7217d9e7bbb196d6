"""What a user reads is said in sentences that are read once, in words that are defined."""

import re
from functools import cache

import pytest

from tests.docs.public_text import (
    ROOT,
    command_help,
    docstring_prose,
    docstrings,
    http_schema,
    markdown_pages,
    prose,
    sections,
    templates,
)

LONGEST = 32  # words of a sentence, or of its part up to a semicolon
# Phrases that were here once, and had to be guessed at.
DISCARDED = (
    "pictures, not verdicts", "whoever", "as the service is set", "same bits", "the error lives", "json-able",
    "see the module's docstring", "of the module's docstring", "hides an error, and explains none",
    "what it comes down to", "comes down to", "is told, and does nothing", "and its like", "not to be had",
)  # fmt: skip
AMERICAN = re.compile(
    r"\b(\w*(normal|discret|linear|minim|maxim|initial|real|recogn|general|optim|standard|summar|factor|character"
    r"|organ|polar|parametr)iz(e|es|ed|ing|ation)s?|behaviors?|colors?|centers?|neighbors?|modeled|modeling"
    r"|canceled|labeled|grays?|catalogs?|analyz(e|ed|ing)|favors?|meters?)\b",
    re.IGNORECASE,
)
TERMS = re.compile(r"expectation maximization", re.IGNORECASE)  # as the sources spell it
KNOWN = {"README", "MIT", "II", "LiTH-ISY-R", "POST", "IEEE"}  # names, and a number
SMALL = {
    "its", "the", "their", "a", "an", "of", "that", "these", "those", "it", "all", "whole", "one", "same",
    "as", "to", "in", "is", "are", "and", "or",
}  # fmt: skip
NEVER_RAISES = {"as_general", "gaussian_case", "model_check", "model_names", "plugin_errors"}


def sentences(paragraph):
    """Sentences, or their parts between semicolons, with each piece of code as one word."""
    text = re.sub(r"``[^`]+``|`[^`]+`", "code", paragraph)
    text = re.sub(r"\b(eqs?|Fig|cf|vs)\. ", r"\1 ", text)
    return [one for one in re.split(r"(?<=[.?!;])\s+", text) if one]


def too_long(paragraph):
    return [one for one in sentences(paragraph) if len(re.findall(r"\w\S*", one)) > LONGEST]


def discarded(text):
    plain = " ".join(text.lower().split())
    return [phrase for phrase in DISCARDED if phrase in plain]


def american(text):
    plain = re.sub(r"`[^`]*`|:\w+:", "", TERMS.sub("", text))
    return [found[0] for found in AMERICAN.finditer(plain)]


def doubled(paragraph):
    plain = re.sub(r"``[^`]+``|`[^`]+`", "code,", paragraph)
    return re.findall(r"(?<![\w-])([a-z]{2,}) \1(?![\w'-])", plain)


def says_nothing_more(entry, description):
    """Whether a description only repeats the name that it describes, such as ``mean : Its mean``."""
    names = {one.lower().rstrip("s") for one in re.split(r"[\W_]+", entry.partition(" : ")[0])}
    words = [one for one in re.findall(r"\w+", description.lower()) if one not in SMALL]
    return len([one for one in words if one.rstrip("s") not in names]) < 2


def without_shape(entry, description):
    """Whether an array is described without its shape."""
    return bool(re.search(r"\barrays?\b", entry)) and not re.search(
        r"\([^()]*\)", entry + description
    )


def abbreviations(paragraph):
    plain = re.sub(r"``[^`]+``|`[^`]+`", "", paragraph)
    return set(re.findall(r"\b(?:[A-Z]{2,}|LiTH)(?:-[A-Z]{1,})*[a-z]?\b", plain)) - KNOWN


def glossary():
    """What the table of abbreviations explains."""
    text = markdown_pages()["words.md"].partition("## Abbreviations")[2].partition("## Sources")[0]
    cells = re.findall(r"^\| ([^|]+) \|", text, re.MULTILINE)
    return {one for cell in cells for one in cell.split(", ")} - {"abbreviation", "---"}


@cache
def paragraphs():
    """(place, paragraph) of all that is read."""
    found = [(place, one) for place, text in docstrings().items() for one in docstring_prose(text)]
    for texts in (markdown_pages(), command_help(), http_schema(), templates()):
        found += [(place, one) for place, text in texts.items() for one in prose(text)]
    return found


def all_that(check):
    return [(place, wrong) for place, text in paragraphs() for wrong in check(text)]


@pytest.mark.parametrize("check", [too_long, discarded, american, doubled])
def test_what_is_read(check):
    assert len(paragraphs()) > 1500
    assert all_that(check) == []


@pytest.mark.parametrize(
    "page", [*ROOT.glob("service/static/**/*.js"), *ROOT.glob("engine/presentation/**/*.py")]
)
def test_what_pages_and_reports_say(page):
    assert discarded(page.read_text(encoding="utf-8")) == []


def entries():
    return [
        (place, entry, text)
        for place, docstring in docstrings().items()
        for title, found in sections(docstring).items()
        for entry, text in found
        if title != "Examples"
    ]


def test_each_argument_is_described_by_more_than_its_name():
    assert len(entries()) > 400
    assert [one for one in entries() if says_nothing_more(*one[1:])] == []
    assert [one for one in entries() if without_shape(*one[1:])] == []


def test_each_option_and_field_is_described_by_more_than_its_name():
    options = {name: text for name, text in command_help().items() if name.count(" ") > 1}
    assert len(options) > 80
    assert [
        name for name, text in options.items() if says_nothing_more(name.split("-")[-1], text)
    ] == []
    fields = {name: text for name, text in http_schema().items() if "." in name}
    assert len(fields) > 60
    assert [
        name for name, text in fields.items() if says_nothing_more(name.rpartition(".")[2], text)
    ] == []


def test_functions_say_what_they_refuse():
    """Those with arguments that can be wrong have a section Raises."""
    import engine

    silent = {
        name.removeprefix("engine.")
        for name, text in docstrings().items()
        if name.count(".") == 1
        and name.partition(".")[2][0].islower()
        and "Raises" not in sections(text)
    }
    assert silent == NEVER_RAISES
    assert silent <= set(engine.__all__)


def test_abbreviations_are_in_the_glossary():
    known = glossary()
    assert len(known) > 15
    read = [
        (place, found)
        for place, text in markdown_pages().items()
        for one in prose(text)
        for found in abbreviations(one)
    ]
    assert [one for one in read if one[1] not in known] == []
    used = {found for place, found in read if place != "words.md"}
    assert known - used == {"rms"}  # none that is not read elsewhere


@pytest.mark.parametrize(
    ("check", "bad", "good"),
    [
        (too_long, "It " + "goes on and " * 11 + "on.", "It goes. " * 30),
        (too_long, "a " * 20 + "and then " + "b " * 20, "a " * 20 + "; then " + "b " * 20),
        (discarded, "These are pictures,\n  not verdicts.", "These are pictures."),
        (american, "The color is normalized.", "The colour is normalised; `normalize(color)`."),
        (doubled, "what the the model says", "what `the the` model says"),
    ],
)
def test_the_checks_find_what_is_wrong(check, bad, good):
    assert check(bad)
    assert not check(good)


def test_the_checks_of_entries_find_what_is_wrong():
    assert says_nothing_more("mean : array (n,)", "Its mean.")
    assert says_nothing_more("n_trajectories : int", "The trajectories.")
    assert says_nothing_more("theta : Theta", "The theta.")
    assert not says_nothing_more("mean : array (n,)", "Expected value of each component.")
    assert without_shape("x : array", "Values of x.")
    assert not without_shape("x : array (n,)", "Values of x.")
    assert abbreviations("ABC-EM and `XYZ` in TH") == {"ABC-EM", "TH"}
