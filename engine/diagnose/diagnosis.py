"""What a diagnosis says, as data: verdict, causes, symptoms, extension, gain, what was testable."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from engine import display, plots
from engine.diagnose.gain import Gain
from engine.diagnose.rounds import Round
from engine.diagnose.search import Search
from engine.diagnose.symptoms import Symptoms
from engine.model import MixedModel, Theta
from engine.report import write_report
from engine.series import Series
from engine.words import probability, tidy


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
    names of all effects the data cannot tell from it, itself first.
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


@dataclass(frozen=True)
class Detectable:
    """What these data would have shown of one effect.

    ``smallest`` is the size found with 80 % probability at the family-wise level, in ``unit``;
    ``rho`` the share of its information left beside the fitted parameters; ``testable`` False where
    the parameters take up all of it, or the data do not excite it.
    """

    effect: str
    title: str
    unit: str
    smallest: float
    rho: float
    testable: bool


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer of :func:`engine.diagnose`; print it for a page a person can read."""

    model: MixedModel
    verdict: Verdict
    causes: tuple[Cause, ...]
    p_value: float
    base_theta: Theta
    extended: MixedModel
    theta: Theta
    symptoms: Symptoms
    gain: Gain | None
    detectable: tuple[Detectable, ...]
    search: Search
    notes: tuple[str, ...]
    seconds: dict[str, float]
    series: Series  # what was given, the held-out part included
    p_bootstrap: float | None = None  # of the first round, where it was asked for

    @property
    def rounds(self) -> tuple[Round, ...]:
        """Every round of screening and refitting."""
        return self.search.rounds

    def __str__(self) -> str:
        from engine.diagnose.report import page

        return page(self)

    def to_dict(self) -> dict[str, Any]:
        """The same content as JSON-able data, with the curves that pictures show."""
        from engine.diagnose.document import as_dict

        return as_dict(self)

    def report(self, path: str | Path) -> Path:
        """Write one self-contained HTML file, which opens from disk and prints; returns its path."""
        return write_report(self.to_dict(), path)

    def figures(self) -> dict[str, Any]:
        """Matplotlib figures by name; needs the extra ``plot``."""
        from engine.diagnose.figures import figures

        return figures(self)

    def plot(self) -> plots.Figures:
        """The same as one object: ``diagnosis.plot().save("figures")``."""
        return plots.Figures(self.figures())

    def _repr_html_(self) -> str:
        from engine.diagnose.report import gain_line

        causes = [
            (c.effect, c.title, c.size, c.standard_error, tidy(c.unit), probability(c.p_value))
            for c in self.causes
        ]
        head = ("effect", "cause", "size", "standard error", "unit", "")
        return display.show(
            f"{self.model.name}: {self.verdict.value}",
            display.line(self.verdict.sentence),
            display.table(head, causes),
            display.lines(self.extended.equations if causes else ()),
            display.line("" if self.gain is None else gain_line(self.gain)),
            display.line("print() shows all of it, .plot() the pictures."),
        )
