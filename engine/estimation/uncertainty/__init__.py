"""How far an estimate may be off: standard errors, and intervals by the likelihood ratio."""

from engine.estimation.uncertainty.likelihood import likelihood_intervals
from engine.estimation.uncertainty.likelihood_result import LikelihoodIntervals
from engine.estimation.uncertainty.observed import standard_errors
from engine.estimation.uncertainty.observed_result import StandardErrors

__all__ = ["LikelihoodIntervals", "StandardErrors", "likelihood_intervals", "standard_errors"]
