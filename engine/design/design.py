"""A designed experiment: the input, what it tells apart, how surely, and what it cannot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.arrays import Array
from engine.design.bounds import Bounds
from engine.design.sensors import Sensor
from engine.statespace.model import MixedModel
from engine.views import Figures, Shown, View, plots, view


@dataclass(frozen=True)
class Undecided:
    """Two causes that the experiment does not tell apart.

    ``D`` is the largest that an input within the bounds reached over the length asked; ``samples`` the length
    that the wanted probability would need at that rate, None where no input tells them apart at all.
    ``sensors`` are further channels with the D they would give, the best first.
    """

    causes: tuple[str, str]
    D: float
    samples: int | None
    sensors: tuple[Sensor, ...] = ()

    @property
    def hopeless(self) -> bool:
        """Whether no input within the bounds tells them apart."""
        return self.samples is None


@dataclass(frozen=True, eq=False)
class Experiment:
    """An input u (T, nu) with what it says of the causes.

    ``D`` (m, m) is that of cause i (row) against j, the rival adapted; ``probability`` (m,) that a diagnosis
    names cause i where it is the true one, against those rivals that inputs tell apart.
    """

    u: Array
    D: Array
    probability: Array
    family: str

    def __len__(self) -> int:
        return len(self.u)

    @property
    def least(self) -> float:
        """The smallest probability of the right name."""
        return float(self.probability.min())


@dataclass(frozen=True, eq=False)
class Design(Shown):
    """The answer of :func:`engine.design_experiment`; print it for a short table.

    Attributes
    ----------
    model : MixedModel
        The model without the causes.
    causes : tuple of str
        Their names (m,).
    titles : tuple of str
        The same in words.
    bounds : Bounds
        What the input may do.
    dt : float
        Time between samples, s.
    experiment : Experiment
        The input of the length asked: ``u`` (T, nu), ``D`` (m, m), ``probability`` (m,).
    shortest : Experiment or None
        The shortest that was found to reach ``level``; None where none does.
    undecided : tuple of Undecided
        Pairs that no input, or none of this length, tells apart, and the sensors that would.
    predictions : array (m, T, ny)
        The outputs that each cause predicts, as estimated.
    growth : array (k, 1 + m)
        Lengths in samples, and the probability of each cause's name in so many samples of the input.
    level : float
        The probability of the right name that is wanted.
    anew : bool
        Whether the new record is diagnosed on its own.
    tried : int
        Inputs that were tried.
    notes : tuple of str
        What else a reader should know.
    seconds : float
        Processor time that it took.
    """

    model: MixedModel
    causes: tuple[str, ...]
    titles: tuple[str, ...]
    bounds: Bounds
    dt: float
    experiment: Experiment
    shortest: Experiment | None
    undecided: tuple[Undecided, ...]
    predictions: Array
    growth: Array
    level: float
    anew: bool
    tried: int
    notes: tuple[str, ...]
    seconds: float

    @property
    def u(self) -> Array:
        """The input (T, nu) of the length asked, in the inputs' units."""
        return self.experiment.u

    @property
    def D(self) -> float:
        """That of the smallest pair among those that inputs tell apart; 0 where there is none."""
        return self.smallest[1]

    @property
    def smallest(self) -> tuple[tuple[str, str], float]:
        """The pair (true cause, rival) that is hardest to tell apart, of those that can be, and its D."""
        hopeless = {frozenset(one.causes) for one in self.undecided if one.hopeless}
        pairs = [
            ((one, other), float(self.experiment.D[i, j]))
            for i, one in enumerate(self.causes)
            for j, other in enumerate(self.causes)
            if i != j and frozenset((one, other)) not in hopeless
        ]
        return min(pairs, key=lambda pair: pair[1], default=((self.causes[0], self.causes[1]), 0.0))

    @property
    def decides(self) -> bool:
        """Whether inputs tell any two of the causes apart."""
        m = len(self.causes)
        return len([one for one in self.undecided if one.hopeless]) < m * (m - 1) // 2

    @property
    def probability(self) -> float:
        """That a diagnosis of the new record names the true cause, whichever it is, at least.

        Causes that no input tells apart count as one; 0 where that is all of them.
        """
        return self.experiment.least if self.decides else 0.0

    def to_dict(self) -> dict[str, Any]:
        """The same as JSON-able data."""
        document: dict[str, Any] = view("design").as_dict(self)
        return document

    def to_csv(self, path: str | Path, shortest: bool = False) -> Path:
        """Write the times and the input, one row a sample.

        Parameters
        ----------
        path : str or Path
            The file to write.
        shortest : bool
            The shortest experiment in place of that of the length asked.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OptionError
            There is no shortest experiment.
        """
        return Path(view("design").write_csv(self, path, shortest))

    def report(self, path: str | Path) -> Path:
        """Write one self-contained HTML file; returns its path."""
        return Path(view("report").write_report({"design": self.to_dict()}, path))

    def plot(self) -> Figures:
        """``input``, ``predictions`` and ``probability``; needs the extra ``plot``."""
        made: Figures = plots().of_document({"design": self.to_dict()})
        return made

    def _view(self) -> View:
        shown: View = view("design").page(self)
        return shown
