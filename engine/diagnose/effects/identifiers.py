"""Names of parameters, made of an effect's kind and its channel, whatever a user calls a channel."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import count


class Identifiers:
    """Names for ``channels``; one spelled as another before, as "T_1" is after "T 1", has a number behind."""

    def __init__(self, channels: Sequence[str]) -> None:
        names = list(dict.fromkeys(channels))
        taken = set(map(_spelled, names))
        seen: set[str] = set()
        self._numbered: dict[str, str] = {}
        for name in names:
            if _spelled(name) in seen:
                free = (f"{name}_{k}" for k in count(2))
                self._numbered[name] = next(word for word in free if _spelled(word) not in taken)
                taken.add(_spelled(self._numbered[name]))
            seen.add(_spelled(name))

    def of(self, *parts: str) -> str:
        """The name made of a kind and channels."""
        return _spelled("_".join(map(self._apart, parts)))

    def _apart(self, part: str) -> str:
        """A channel, or those that an arrow or a comma joins."""
        known = self._numbered
        if part in known:
            return known[part]
        return "".join(known.get(word, word) for word in re.split("(->|,)", part))


def _spelled(name: str) -> str:
    """The name with nothing but letters, digits and underscores."""
    return "".join(c if c.isalnum() else "_" for c in name)
