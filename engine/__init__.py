"""Maximum-likelihood identification of mixed linear/nonlinear state-space models.

Start with :func:`get_model` or your own :class:`MixedModel`, put measured data into a
:class:`Series`, and estimate with :func:`rbps_em`.
"""

from engine.conditional import condition_on_trajectories
from engine.densities import GaussianMixture, StudentT
from engine.diagnose import Diagnosis, diagnose, register_effect
from engine.diagnose.extended import get_model
from engine.discretize import discretize
from engine.em import Checkpoint, EmResult, Iteration, rbps_em, rts_em
from engine.errors import EngineError, ModelError, NotSettledWarning, OptionError, SeriesError
from engine.examine import Examination, examine
from engine.free_run import free_run
from engine.heavy_tails import with_mixture, with_student_t
from engine.kalman import kalman_smoother
from engine.linear_cost import rb_ffbsi_linear
from engine.model import Gaussian, MixedModel, Parameter, Theta
from engine.nonlinear import NonlinearModel, as_general
from engine.nonlinear_smoother import filter_general, smooth_general
from engine.outcome import Outcome
from engine.particle import ParticleFiltered, ParticleSmoothed, ffbsi, particle_filter
from engine.ps_em import ps_em
from engine.rb_ffbsi import Smoothed, rb_ffbsi
from engine.rbpf import Filtered, rbpf
from engine.registry import model_names, plugin_errors, register
from engine.report import write_report
from engine.series import Series
from engine.simulate import Simulation, simulate
from engine.simulation_fit import fit_simulation
from engine.special_case import SpecialCase, gaussian_case, rb_ffbsi_special, rbpf_special
from engine.standard_errors import (
    LikelihoodIntervals,
    StandardErrors,
    likelihood_intervals,
    standard_errors,
)

__all__ = [
    "Checkpoint",
    "Diagnosis",
    "EmResult",
    "EngineError",
    "Examination",
    "Filtered",
    "Gaussian",
    "GaussianMixture",
    "Iteration",
    "LikelihoodIntervals",
    "MixedModel",
    "ModelError",
    "NonlinearModel",
    "NotSettledWarning",
    "OptionError",
    "Outcome",
    "Parameter",
    "ParticleFiltered",
    "ParticleSmoothed",
    "Series",
    "SeriesError",
    "Simulation",
    "Smoothed",
    "SpecialCase",
    "StandardErrors",
    "StudentT",
    "Theta",
    "as_general",
    "condition_on_trajectories",
    "diagnose",
    "discretize",
    "examine",
    "ffbsi",
    "filter_general",
    "fit_simulation",
    "free_run",
    "gaussian_case",
    "get_model",
    "kalman_smoother",
    "likelihood_intervals",
    "model_names",
    "particle_filter",
    "plugin_errors",
    "ps_em",
    "rb_ffbsi",
    "rb_ffbsi_linear",
    "rb_ffbsi_special",
    "rbpf",
    "rbpf_special",
    "rbps_em",
    "register",
    "register_effect",
    "rts_em",
    "simulate",
    "smooth_general",
    "standard_errors",
    "with_mixture",
    "with_student_t",
    "write_report",
]
