"""What is known of a diagnosis while its search goes on: the fitted model, what it gets wrong, a first screen.

It is told as a JSON document as soon as the model is fitted, and again after the first screen. Its symptoms
are those that the diagnosis ends with, unless the free run decides otherwise; its screen is what the search
sets out from: scores of one step, neither weighed against each other nor calibrated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from engine.data.series import Series
from engine.diagnose.screening.screen import Screen
from engine.diagnose.symptoms.runs import covariance_of
from engine.diagnose.symptoms.symptoms import find_symptoms
from engine.errors import EngineError
from engine.estimation.quasi_ml import QuasiFit
from engine.json_values import plain
from engine.statespace.model import MixedModel
from engine.words import enumerated

Told = Callable[[dict[str, Any]], object]

FIRST_SCREEN = "round 1: screen"  # the name of that part
SHOWN, SAID = 8, 3  # of the largest scores
SUSPECT = 0.05  # p-value of a single score from which it is said


class EarlyAnswer:
    """Told the finished parts of a diagnosis, tells what is known by them."""

    def __init__(
        self, tell: Told, model: MixedModel, series: Series, fitted: Series, seed: int
    ) -> None:
        self._tell, self._model, self._series, self._seed = tell, model, series, seed
        self._fitted = fitted
        self._document: dict[str, Any] | None = None

    def __call__(self, name: str, found: Any) -> None:
        """A part was finished, or had been before: the fit of the model, or the first screen."""
        if isinstance(found, QuasiFit) and name == f"fit {self._model.name}":
            self._document = self._of_fit(found)
        elif isinstance(found, Screen) and name == FIRST_SCREEN and self._document is not None:
            self._document = self._document | _of_screen(found)
        else:
            return
        if self._document is not None:
            self._tell(plain(self._document))

    def _of_fit(self, fit: QuasiFit) -> dict[str, Any] | None:
        """None where the simulation cannot be made: the diagnosis will say why."""
        model, errors = self._model, fit.standard_errors.tolist()
        try:
            uncertain = covariance_of(fit)
            symptoms = find_symptoms(
                model, fit.theta, self._series, uncertain, seed=self._seed, fitted=self._fitted
            )
        except EngineError:
            return None
        known = dict(zip(fit.free, errors, strict=True))
        return {
            "model": model.name,
            "outputs": dict(model.outputs),
            "time_unit": self._series.time_unit,
            "estimate": {
                p.name: {
                    "value": value,
                    "standard_error": known.get(p.name),
                    "unit": p.unit,
                    "fixed": p.name not in known,
                }
                for p, value in zip(model.parameters, fit.theta.tolist(), strict=True)
            },
            "log_likelihood": fit.log_likelihood,
            "symptoms": symptoms.to_dict(),
            "sentences": list(symptoms.sentences),
            "screen": None,
        }


def _of_screen(screen: Screen) -> dict[str, Any]:
    best = [score for score in screen.scores if score.statistic > 0.0][:SHOWN]
    suspects = [score.effect.name for score in best if score.p_value <= SUSPECT][:SAID]
    sentence = (
        f"The first screen points to {enumerated(suspects, 'or')}; neither refitted nor compared yet."
        if suspects
        else "The first screen points to no effect of the catalogue."
    )
    return {
        "screen": {
            "p_value": screen.p_value,
            "sentence": sentence,
            "scores": [
                {
                    "effect": score.effect.name,
                    "title": score.effect.title,
                    "size": score.size,
                    "standard_error": score.se,
                    "unit": score.effect.size.unit,
                    "statistic": score.statistic,
                    "p_value": score.p_value,
                }
                for score in best
            ],
        }
    }
