"""What a search may answer: verdicts, causes with their look-alikes, and what would have been seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from engine.words import probability

# What is said of a look-alike that is not ruled out.
AS_LIKELY = "is as likely, but with more parameters to choose"
AS_GOOD = "is no worse on rows left out, as far as these tell"
SAME = "says the same in other words here"  # of another name for the same thing
LESS_LIKELY = "is less likely, by a factor of"
CONTRADICTED = "is as likely here, and held-out data speak against it"
WAS_LIKELIER = "was likelier before what was found beside the cause"


class Verdict(Enum):
    """The four answers; ``value`` is the word used at every edge, ``sentence`` what it means."""

    NOTHING = "nothing"
    NAMED = "named"
    SET = "set"
    UNKNOWN = "unknown"

    @property
    def sentence(self) -> str:
        """What the verdict says."""
        return {
            "nothing": "These data show nothing that the model leaves out.",
            "named": "The model leaves something out, and the data say what.",
            "set": "The model leaves something out; these data cannot tell several causes apart.",
            "unknown": "The model leaves something out, and no known cause settles what it is.",
        }[self.value]


@dataclass(frozen=True)
class LookAlike:
    """Another effect that might be taken for the cause.

    ``likeness`` is |cos| of the two footprints, ``gain`` its 2 x log-likelihood gained (None where it
    was not refitted), ``ruled_out`` whether the data tell it apart; ``difference`` what would.
    """

    effect: str
    likeness: float
    gain: float | None
    ruled_out: bool
    difference: str


@dataclass(frozen=True)
class Cause:
    """One step of the search: an effect that explains what was left.

    ``where`` is the family (state, measurement, noise, input, time); ``size`` with ``unit`` and
    ``standard_error``; ``p_value`` family-wise; ``gain`` = 2 (log-likelihood gained); ``equivalent`` the
    names of all effects the data cannot tell from it, itself first; ``together`` names that were chosen with
    it: the gain is that of all of them; ``beside`` names of the other causes, where the gain is what it adds
    to them; ``at_floor`` whether ``p_value`` is the least that so many simulated
    series can give. Of a wave ``size`` is the part of the cosine, and ``amplitude`` with ``amplitude_error``
    is how large it is, in the same unit; None of all else.
    """

    effect: str
    title: str
    where: str
    equation: str
    size: float
    unit: str
    standard_error: float
    parameters: dict[str, float]
    p_value: float
    gain: float
    equivalent: tuple[str, ...]
    look_alikes: tuple[LookAlike, ...]
    together: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)  # of ``parameters``
    at_floor: bool = False
    amplitude: float | None = None
    amplitude_error: float | None = None

    @property
    def in_other_words(self) -> tuple[str, ...]:
        """Names that say the same on these data: other physics, which another experiment may tell apart."""
        return tuple(other.effect for other in self.look_alikes if other.difference == SAME)

    @property
    def not_ruled_out(self) -> tuple[str, ...]:
        """Names that are less likely than this one, but not by enough to rule them out."""
        apart = (
            o
            for o in self.look_alikes
            if o.difference.startswith((AS_GOOD, AS_LIKELY, LESS_LIKELY))
        )
        return tuple(other.effect for other in apart)

    @property
    def probability(self) -> str:
        """``p_value`` in words."""
        return probability(self.p_value, self.at_floor)


@dataclass(frozen=True)
class Detectable:
    """What these data would have shown of one effect.

    ``smallest`` is the size found with 80 % probability at the family-wise level, in ``unit``;
    ``rho`` the share of its information left beside the fitted parameters; ``testable`` False where
    the parameters take up all of it, the data do not excite it, or no size that it may have is so large.
    """

    effect: str
    title: str
    unit: str
    smallest: float
    rho: float
    testable: bool
