"""The engine's advice as who reads a page or an answer can follow it: without the words of the library."""

from __future__ import annotations

from typing import Any

# What the engine says to who calls it from Python, and what is said in place of that.
_WORDS = {
    " (Parameter(bounds=))": "",
    " (theta=, free=)": "",
    " (free=)": "",
    " (held_out=, or test=)": " (held_out, or test)",
    " (held_out=)": " (held_out)",
    " (test=)": " (test)",
    "held_out=0 searches": "held_out = 0 searches",
    "test= judges": "test judges",
    "method='quasi-newton'": "the method quasi-newton",
    "read with hold='": "read with hold = '",
    "n_particles and n_trajectories": "particles and trajectories",
    "n_particles, n_trajectories or": "particles, trajectories or",
    "n_particles": "particles",
}


def plain(text: str) -> str:
    """A sentence of the engine without the library's words."""
    for said, instead in _WORDS.items():
        text = text.replace(said, instead)
    return text


def plain_throughout(document: Any) -> Any:
    """The same of all sentences in a document; lists of numbers are left as they are."""
    if isinstance(document, str):
        return plain(document)
    if isinstance(document, dict):
        return {name: plain_throughout(value) for name, value in document.items()}
    if isinstance(document, list | tuple) and any(
        isinstance(one, str | dict | list) for one in document[:1]
    ):
        return [plain_throughout(one) for one in document]
    return document
