"""A designed experiment: the input, what it tells apart, how surely, and what it cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.arrays import Array
from engine.design.bounds import Bounds
from engine.design.sensors import Sensor
from engine.statespace.model import MixedModel
from engine.units import SECOND
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
        Names (m,) of the causes to tell apart, such as ``drag:velocity``.
    titles : tuple of str
        What each of the causes is, in words.
    bounds : Bounds
        Limits that the inputs, states and outputs keep.
    dt : float
        Time between samples, in ``bounds.time_unit``.
    experiment : Experiment
        The experiment of the length asked for: its input ``u`` (T, nu), ``D`` (m, m) and the ``probability``
        (m,) of each cause's name.
    shortest : Experiment or None
        The shortest experiment that was found to reach ``level``; None where none does.
    undecided : tuple of Undecided
        Pairs of causes that no input, or none of this length, tells apart, and the sensors that would.
    predictions : array (m, T, ny)
        The outputs that each cause predicts, as estimated.
    growth : array (k, 1 + m)
        Lengths in samples (first column), and the probability of each cause's name in a record of that length.
    level : float
        Probability of the right name that is aimed at.
    anew : bool
        Whether the new record is diagnosed on its own, without what the earlier record told.
    tried : int
        How many inputs were tried.
    notes : tuple of str
        Sentences on causes left out and on other limits of the design.
    seconds : float
        Processor time that the search took, s.
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
    def time_unit(self) -> str:
        """The unit that times, rates and frequencies are in."""
        return self.bounds.time_unit or SECOND

    @property
    def u(self) -> Array:
        """The input (T, nu) of the length asked for, in the inputs' units."""
        return self.experiment.u

    @property
    def D(self) -> float:
        """The smallest D over the pairs of causes that inputs tell apart; 0 where there is none."""
        return self.smallest[1]

    @property
    def smallest(self) -> tuple[tuple[str, str], float]:
        """The pair (true cause, rival) that is hardest to tell apart, of those that can be, and its D."""
        return hardest(self.causes, self.experiment.D, hopeless_pairs(self.undecided))

    @property
    def decides(self) -> bool:
        """Whether inputs tell any two of the causes apart."""
        m = len(self.causes)
        return len([one for one in self.undecided if one.hopeless]) < m * (m - 1) // 2

    @property
    def probability(self) -> float:
        """The least probability, over the causes, that a diagnosis of the new record names the true one.

        Causes that no input tells apart count as one; 0 where that is all of them.
        """
        return self.experiment.least if self.decides else 0.0

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON values."""
        document: dict[str, Any] = view("design").as_dict(self)
        return document

    def to_csv(self, path: str | Path, shortest: bool = False) -> Path:
        """Write the times and the input, one row a sample.

        Parameters
        ----------
        path : str or Path
            The file to write.
        shortest : bool
            Whether to write the shortest experiment in place of that of the length asked for.

        Returns
        -------
        Path
            The file that was written.

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
        """Draw the figures ``input``, ``predictions`` and ``probability``; needs the extra ``plot``."""
        made: Figures = plots().of_document({"design": self.to_dict()})
        return made

    def _view(self) -> View:
        shown: View = view("design").page(self)
        return shown


def hopeless_pairs(undecided: Sequence[Undecided]) -> set[frozenset[str]]:
    """The pairs of causes that no input within the bounds tells apart."""
    return {frozenset(one.causes) for one in undecided if one.hopeless}


def hardest(
    causes: Sequence[str], D: Array, hopeless: set[frozenset[str]]
) -> tuple[tuple[str, str], float]:
    """The pair (true cause, rival) of the least D (m, m) and that D, of those not hopeless; 0 of none."""
    pairs = [
        ((one, other), float(D[i, j]))
        for i, one in enumerate(causes)
        for j, other in enumerate(causes)
        if i != j and frozenset((one, other)) not in hopeless
    ]
    return min(pairs, key=lambda pair: pair[1], default=((causes[0], causes[1]), 0.0))
