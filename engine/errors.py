"""What can be wrong, as one tree of exceptions.

    EngineError
    +-- ModelError      a model's functions, shapes or covariances
    +-- SeriesError     the measured data
    +-- OptionError     an argument of an algorithm

Every message names what was wrong, where, and what to do about it. What can be gone on with is a warning:

    UserWarning
    +-- NotSettledWarning   the uncertainty of something that is no maximum of the likelihood
    +-- ReadingWarning      a file that could be read in several ways
"""

from __future__ import annotations

from numbers import Integral


class EngineError(ValueError):
    """Base class of errors that the caller can put right; the message says what to do."""


class NotSettledWarning(UserWarning):
    """Standard errors were asked for at parameters that are no maximum of the likelihood."""


class ReadingWarning(UserWarning):
    """A file could be read in several ways, for example as two columns may have the times; says how it was."""


class ModelError(EngineError):
    """A model's function failed, or returned something that no algorithm can use.

    ``placed`` says that the message names function, time and shapes already. ``numeric`` says that a
    calculation failed at the values it was given, as it may at a trial of the parameters; the model itself may
    be right.
    """

    def __init__(self, message: str, *, placed: bool = False, numeric: bool = False) -> None:
        super().__init__(message)
        self.placed, self.numeric = placed, numeric


class SeriesError(EngineError):
    """The measured data cannot be used as they are; the message names the row and the channel."""


class OptionError(EngineError):
    """An argument is unknown or out of its range; ``field`` names it."""

    def __init__(self, message: str, field: str = "") -> None:
        super().__init__(message)
        self.field = field


def check_count(name: str, value: object) -> None:
    """Raise OptionError unless the argument ``name`` is a positive whole number."""
    if not isinstance(value, Integral) or int(value) < 1:
        raise OptionError(f"{name} = {value!r}; a positive whole number is needed", name)
