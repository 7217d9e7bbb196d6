"""All that a user reads, {place: text}: docstrings, Guide, README, help of the commands, HTTP schema, pages."""

import inspect
import re
from functools import cached_property
from pathlib import Path

import typer.main
from pydantic import TypeAdapter

import engine
from service import responses, schemas
from service.cli.commands import app

ROOT = Path(__file__).parents[2]
GUIDE = sorted((ROOT / "service" / "guide" / "pages").glob("*.md"))
TEMPLATES = sorted((ROOT / "service" / "templates").glob("*.html"))


def documented():
    """{name: object} of everything in ``engine.__all__``, and of the public members of its classes."""
    found = {}
    for name in sorted(engine.__all__):
        thing = getattr(engine, name)
        found[f"engine.{name}"] = thing
        if inspect.isclass(thing):
            found |= {f"engine.{name}.{key}": value for key, value in members(thing).items()}
    return found


def members(described):
    """Methods and properties of a class that ``engine`` itself documents."""
    found = {}
    for base in reversed(described.__mro__):
        if base.__module__.partition(".")[0] != "engine":
            continue
        for key, value in vars(base).items():
            if isinstance(value, property | cached_property):
                value = getattr(value, "fget", None) or value.func
            value = getattr(value, "__func__", value)
            if not key.startswith("_") and inspect.isfunction(value) and value.__doc__:
                found[key] = value
    return found


def docstrings():
    """Every public docstring, whole."""
    return {name: inspect.getdoc(thing) for name, thing in documented().items()}


def markdown_pages():
    """The README and the Guide."""
    return {page.name: page.read_text(encoding="utf-8") for page in (ROOT / "README.md", *GUIDE)}


def command_help():
    """{"rbps fit --particles": text} of every command, argument and option."""
    group = typer.main.get_command(app)
    found = {"rbps": f"{group.help}"}
    for name, command in group.commands.items():
        found[f"rbps {name}"] = f"{command.short_help}\n\n{command.help}"
        for parameter in command.params:
            words = getattr(parameter, "help", None)
            assert words, f"rbps {name} {parameter.name} is not described"
            found[f"rbps {name} {parameter.opts[0]}"] = words
    return found


def http_schema():
    """Descriptions of every model and field that requests and answers have."""
    found = {}
    models = [TypeAdapter(schemas.JobRequest), *(TypeAdapter(one) for one in _answers())]
    for one in models:
        schema = one.json_schema()
        for name, model in (schema.pop("$defs", {}) | {schema.get("title", ""): schema}).items():
            found[name] = model.get("description", "")
            for key, field in model.get("properties", {}).items():
                found[f"{name}.{key}"] = field.get("description", "")
    return {place: text for place, text in found.items() if text}


def _answers():
    return [
        one for one in vars(responses).values()
        if inspect.isclass(one) and one.__module__ == responses.__name__
    ]  # fmt: skip


def templates():
    """What the pages of the service say before any script has run."""
    found = {}
    for page in TEMPLATES:
        text = re.sub(r"{[%#].*?[%#]}", " ", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        text = re.sub(r"</(p|li|h\d|th|td|label|option|span|button|strong|summary)>", "\n\n", text)
        found[page.name] = re.sub(r"<[^>]*>", " ", text)
    return found


def sections(docstring):
    """{title: [(entry, its lines)]} of a docstring's numpydoc sections."""
    parts = re.split(r"\n([A-Z][a-z]+)\n-+\n", docstring)
    found = {}
    for title, text in zip(parts[1::2], parts[2::2], strict=True):
        entries = []
        for line in text.splitlines():
            if line[:1].strip():
                entries.append((line, []))
            elif line.strip() and entries:
                entries[-1][1].append(line.strip())
        found[title] = [(entry, " ".join(lines)) for entry, lines in entries]
    return found


def prose(text):
    """Paragraphs, list items, headings and cells of a text, without its code, formulas and tables of signs."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"^(    |>>>|\.\.\.).*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"^\|?( *-+ *\|)+ *$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^(#+|-|\*) ", "\n\n", text, flags=re.MULTILINE)
    text = re.sub(r"\|", "\n\n", text)
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]


def docstring_prose(docstring):
    """The same of a docstring, whose entries' descriptions are indented."""
    head, *_ = re.split(r"\n[A-Z][a-z]+\n-+\n", docstring)
    found = prose(head)
    for title, entries in sections(docstring).items():
        if title != "Examples":
            found += [text for _, text in entries if text]
    return found
