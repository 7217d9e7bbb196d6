"""Maximum-likelihood identification of mixed linear/nonlinear state-space models.

Start with :func:`get_model` or your own :class:`MixedModel`, put measured data into a
:class:`Series`, and estimate with :func:`rbps_em`.
"""

from engine.data.joined import in_turn
from engine.data.series import Series
from engine.design import Bounds, Design, InputBounds, design_experiment
from engine.diagnose import Diagnosis, diagnose, register_effect
from engine.diagnose.extended import get_model
from engine.errors import (
    EngineError,
    ModelError,
    NotSettledWarning,
    OptionError,
    ReadingWarning,
    SeriesError,
)
from engine.estimation.em import Checkpoint, EmResult, Iteration, rbps_em, rts_em
from engine.estimation.outcome import Outcome
from engine.estimation.ps_em import ps_em
from engine.estimation.uncertainty import (
    LikelihoodIntervals,
    StandardErrors,
    likelihood_intervals,
    standard_errors,
)
from engine.filters.heavy_tails import with_mixture, with_student_t
from engine.filters.kalman import kalman_smoother
from engine.filters.particle import ParticleFiltered, particle_filter
from engine.filters.rbpf import Filtered, rbpf
from engine.models.files import model_from
from engine.models.registry import model_names, plugin_errors, register, register_files
from engine.presentation.examination import Examination, examine
from engine.presentation.model_check import model_check
from engine.presentation.report import write_report
from engine.saved import load, save
from engine.simulation.fit import SimulationFit, fit_simulation
from engine.simulation.free_run import free_run
from engine.simulation.simulate import Simulation, simulate
from engine.smoothers.exact_conditional import condition_on_trajectories
from engine.smoothers.ffbsi import ParticleSmoothed, ffbsi
from engine.smoothers.general import filter_general, smooth_general
from engine.smoothers.linear_cost import rb_ffbsi_linear
from engine.smoothers.rb_ffbsi import Smoothed, rb_ffbsi
from engine.smoothers.special_case import SpecialCase, gaussian_case, rb_ffbsi_special, rbpf_special
from engine.statespace.continuous import continuous
from engine.statespace.densities import GaussianMixture, StudentT
from engine.statespace.discretization import discretize
from engine.statespace.general import NonlinearModel, as_general
from engine.statespace.model import Gaussian, MixedModel, Parameter, Theta

__all__ = [
    "Bounds",
    "Checkpoint",
    "Design",
    "Diagnosis",
    "EmResult",
    "EngineError",
    "Examination",
    "Filtered",
    "Gaussian",
    "GaussianMixture",
    "InputBounds",
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
    "ReadingWarning",
    "Series",
    "SeriesError",
    "Simulation",
    "SimulationFit",
    "Smoothed",
    "SpecialCase",
    "StandardErrors",
    "StudentT",
    "Theta",
    "as_general",
    "condition_on_trajectories",
    "continuous",
    "design_experiment",
    "diagnose",
    "discretize",
    "examine",
    "ffbsi",
    "filter_general",
    "fit_simulation",
    "free_run",
    "gaussian_case",
    "get_model",
    "in_turn",
    "kalman_smoother",
    "likelihood_intervals",
    "load",
    "model_check",
    "model_from",
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
    "register_files",
    "rts_em",
    "save",
    "simulate",
    "smooth_general",
    "standard_errors",
    "with_mixture",
    "with_student_t",
    "write_report",
]
