"""What a diagnosis says, as data: verdict, causes, symptoms, extension, gain, what was testable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from engine.data.faults import faults_of
from engine.data.series import Series
from engine.diagnose.effects.kinds.parameters import stopped_share
from engine.diagnose.free_run.answer import FreeRunSearch
from engine.diagnose.free_run.second_opinion import SecondOpinion
from engine.diagnose.gain.gain import Gain
from engine.diagnose.judging.findings import Cause, Detectable, Verdict
from engine.diagnose.judging.unsearched import Unsearched
from engine.diagnose.over_horizon import OverHorizon
from engine.diagnose.refits.found import Search
from engine.diagnose.refits.rounds import Round
from engine.diagnose.screening.noise_parameters import noise_of
from engine.diagnose.symptoms.symptoms import Symptoms
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.statespace.model import MixedModel, Theta
from engine.views import Figures, Shown, View, plots, save, sheet, tables, view
from engine.words import enumerated, tidy, with_unit


@dataclass(frozen=True, eq=False)
class Asked:
    """What :func:`engine.diagnose` was asked, and the parts that it finished.

    Attributes
    ----------
    model : MixedModel
        As it was given.
    series : Series or sequence of Series
        As it was given.
    test : Series, sequence of Series or None
        As it was given.
    options : dict
        The other arguments that change the answer, as JSON values.
    parts : mapping
        What ``kept`` holds: finished parts as JSON values.
    """

    model: MixedModel
    series: Series | Sequence[Series]
    test: Series | Sequence[Series] | None
    options: dict[str, Any]
    parts: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
    """The answer of :func:`engine.diagnose`; print it for a page a person can read.

    Attributes
    ----------
    model : MixedModel
        The model that was diagnosed.
    verdict : Verdict
        ``nothing``, ``named``, ``set`` or ``unknown``: whether the model leaves something out, and whether that
        has a name.
    causes : tuple of Cause
        Effects that explain it, in the order found, with sizes and standard errors.
    p_value : float
        Probability of as much evidence as in the first round where nothing is wrong.
    base_theta : Theta
        Parameters (n_theta,) of the model without the causes, as fitted to the data.
    extended : MixedModel
        The model with the causes in it.
    theta : Theta
        Parameters of the extended model, those of the causes last.
    symptoms : Symptoms
        What the fitted model's simulation and predictions get wrong, whatever the cause.
    gain : Gain or None
        What the extension gains on held-out data; None where nothing was found.
    detectable : tuple of Detectable
        The smallest size of each effect that would have been found.
    search : Search
        The rounds of screening and refitting.
    notes : tuple of str
        Sentences on the data and on limits of the answer.
    seconds : dict
        {part: seconds that it took by the clock}; those of a kept part are of when it was made.
    series : Series
        The record that the likelihood searched, the held-out part included; of several the longest.
    records : int
        How many records were given.
    later, starts : tuple of float
        Of several records on one clock, times at which one ends and the next begins: a step may end with its
        record, and a drift counts anew.
    p_bootstrap : float or None
        The first round's p-value from simulated series, where it was asked for.
    p_bootstrap_at_floor : bool
        Whether that is the least that so many series can give, so that it may be any smaller.
    free_run : SecondOpinion or None
        What the fit of the simulation without noise finds, and whether it decided the verdict.
    substeps : int
        Number of steps from sample to sample that the models made; refine a series by it to run ``extended``.
    over_horizon : OverHorizon or None
        The answer beside the other candidates, over the horizon and over budgets of process noise.
    unsearched : Unsearched or None
        Where nothing was found: an event that the screen sees in the rows held out, which were not searched.
    by_record : str
        Where several records have parameters of their own, a sentence that says which; "" where none is seen.
    why : tuple of str
        Of a verdict that is ``unknown``: why what was found is not trusted, the first of these notes. Of
        ``nothing``: why what seemed to be seen is taken for chance, if anything did.
    asked : Asked or None
        The arguments and the finished parts, by which :func:`engine.save` keeps the diagnosis.
    """

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
    series: Series  # the longest that was given, the held-out part included
    p_bootstrap: float | None = None  # of the first round, where it was asked for
    free_run: SecondOpinion | None = None
    substeps: int = 1  # steps a sample
    records: int = 1  # given
    over_horizon: OverHorizon | None = None
    asked: Asked | None = None  # what was asked, by which it can be kept
    # of the records searched: where a step may end with its record, and from where a drift counts anew
    later: tuple[float, ...] = ()
    starts: tuple[float, ...] = ()
    p_bootstrap_at_floor: bool = False
    unsearched: Unsearched | None = None
    by_record: str = ""
    why: tuple[str, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:  # its models hold functions made on the spot
        if self.asked is None:
            raise TypeError(
                "a diagnosis is pickled by what was asked, which this one does not know"
            )
        asked = self.asked
        arguments = (asked.model, asked.series, asked.test, asked.options, dict(asked.parts))
        return import_module("engine.diagnose").again, arguments

    @property
    def p_at_floor(self) -> bool:
        """Whether ``p_value`` is the least that so many draws can give, so that it may be any smaller."""
        return self.search.rounds[0].screen.at_floor

    @property
    def decided_by(self) -> str:
        """The criterion that decided: ``likelihood`` or ``free run``."""
        return "free run" if self.free_run is not None and self.free_run.decides else "likelihood"

    def _stopped_as_they_change(self) -> list[str]:
        """Sentences on causes that change a parameter, which a bound holds back in a part of the record.

        As each was found first: beside later ones, which say what it cannot, it may be off the bound.
        """
        names = [cause.effect for cause in self.causes]
        rounds = ([self.search.begun] if self.search.begun else []) + [*self.search.rounds]
        out: dict[str, str] = {}
        for one in (found.refits[0] for found in rounds if found.equivalent):
            name, fit = one.effect.name, one.fit
            share = stopped_share(one.effect, fit.model, fit.theta, self.series)
            if name not in names or not share or name in out:
                continue
            others = enumerated([other for other in names if other != name])
            more = f", and {others} may only make up for that" if others else ""
            out[name] = (
                f"With {name} a bound of the parameter holds it back in {100 * share:.2g} % of the samples: "
                f"how it goes on there is not in the answer{more}. Wider bounds tell, where it may go beyond."
            )
        return [*out.values()]

    @property
    def faults(self) -> tuple[str, ...]:
        """What to look at in the record before any cause is believed: dead, cut, stuck, given twice, marks."""
        if self.verdict is Verdict.NOTHING:
            return ()
        return faults_of(self.model.outputs, self.model.inputs, self.series)

    @cached_property
    def stopped(self) -> tuple[str, ...]:
        """Sentences on parameters of the model as given, but those of its noise, that a bound has stopped.

        Before anything was added, or with what was found: that may say again what the parameter has said.
        """
        fit, before, still = self.before, set[str](), set[str]()
        if self.causes:
            before = {*fit.model.stopped_by_bounds(fit.theta, fit.free, fit.ties)}
            still = {*self.extended.stopped_by_bounds(self.theta, fit.free, self.after.ties)}
        noise = set[str]()
        if before | still:
            with suppress(EngineError, np.linalg.LinAlgError):
                of_noise = noise_of(fit, self.series)
                noise = {name for name, yes in zip(fit.free, of_noise, strict=True) if yes}
        units = {p.name: p.unit for p in fit.model.parameters}

        def said(name: str) -> str:
            at, then = (
                with_unit(float(theta[name]), units[name]) for theta in (fit.theta, self.theta)
            )
            if name not in before:
                return (
                    f"With what was found, {name} is stopped by its bound, {then}, where it was {at}: what was "
                    "found may say again what it said, and its size then depends on that bound."
                )
            text = f"Before anything was added, {name} was stopped by its bound, {at}: "
            if name in still:
                return f"{text}what was found may only make up for that."
            return f"{text}what was found makes up for that, or drove it there. With it, {name} is {then}."

        out = [said(name) for name in fit.free if name in (before | still) - noise]
        return (*out, *self._stopped_as_they_change())

    @property
    def trusted(self) -> bool:
        """Whether the names of the causes are, so that an extension by them may be adopted."""
        return self.verdict is not Verdict.UNKNOWN

    @property
    def adopted(self) -> bool:
        """Whether the extension is: held-out data call for it, and the names of its causes are trusted."""
        return self.gain is not None and self.gain.adopt and self.trusted

    @property
    def measured(self) -> tuple[str, ...]:
        """The outputs of which the record has readings."""
        seen = self.series.observed
        return tuple(name for i, name in enumerate(self.model.outputs) if seen[:, i].any())

    @property
    def before(self) -> QuasiFit:
        """The fit without what was found, by the criterion that decided."""
        told = self._told
        return self.search.base if told is None else told.before

    @property
    def after(self) -> QuasiFit:
        """The fit with what was found, by the criterion that decided."""
        told = self._told
        return self.search.final if told is None else told.after

    @property
    def _told(self) -> FreeRunSearch | None:
        """What the free run found, where it decided."""
        asked = self.free_run
        found = asked.search if asked is not None and asked.decides else None
        return found if found is not None and found.found else None

    @property
    def rounds(self) -> tuple[Round, ...]:
        """Every round of screening and refitting."""
        return self.search.rounds

    def __str__(self) -> str:
        return str(view("diagnosis_text").page(self))

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON values, with the curves that pictures show."""
        document: dict[str, Any] = view("diagnosis_document").as_dict(self)
        return document

    def report(self, path: str | Path) -> Path:
        """Write one self-contained HTML file, which opens from disk and prints; returns its path."""
        written: Path = view("report").write_report(self.to_dict(), path)
        return written

    def figures(self) -> dict[str, Any]:
        """Matplotlib figures by name; needs the extra ``plot``."""
        return dict(self.plot())

    def plot(self) -> Figures:
        """All figures as one object: ``.plot().save("figures")`` writes them; needs the extra ``plot``."""
        made: Figures = plots().of_document({"diagnosis": self.to_dict()})
        return made

    def save(self, path: str | Path) -> Path:
        """Write it with its model; :func:`engine.load` reads it."""
        return save(self, path)

    def _view(self) -> View:
        causes = [(c.effect, c.title, *_sized(c), tidy(c.unit), c.probability) for c in self.causes]
        head = ("effect", "cause", "size", "standard error", "unit", "")
        return sheet(
            f"{self.model.name}: {self.verdict.value}",
            tables().line(self.verdict.sentence),
            tables().table(head, causes),
            tables().lines(self.extended.equations if causes else ()),
            tables().line(
                ""
                if self.gain is None
                else view("diagnosis_text").gain_line(self.gain, self.trusted)
            ),
            tables().line("print() shows all of it, .plot() the pictures."),
        )


def _sized(cause: Cause) -> tuple[float, float | None]:
    """The size of a cause with its error, of a wave its amplitude."""
    if cause.amplitude is not None:
        return cause.amplitude, cause.amplitude_error
    return cause.size, cause.standard_error
