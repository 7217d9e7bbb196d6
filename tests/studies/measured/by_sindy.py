"""Sparse regression by PySINDy on the same records: its terms, as effects of the catalogue, judged alike.

The states are those of the smoother of the estimated base model, the library of terms and the two settings
those of :mod:`tests.studies.sindy`, chosen on simulated series. Each equation is searched that is no definition
and that inputs or other states move. What is found is added to the base model, with the constant that every
such equation has, and fitted to the free run.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from engine.data.series import Series
from engine.diagnose import make_effect
from engine.diagnose.effects.of_series import setting_for
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.windows import rows_searched, telling
from engine.diagnose.records import records_of
from engine.diagnose.search.pipeline import fit_base
from engine.diagnose.steps.substeps import prepare
from engine.errors import EngineError, ModelError
from engine.estimation.quasi_ml import QuasiFit
from engine.filters.kalman import kalman_smoother
from engine.filters.rbpf import rbpf
from engine.simulation.fit import SimulationFit, fit_simulation
from engine.smoothers.rb_ffbsi import rb_ffbsi
from engine.statespace.model import Array
from tests.studies.measured.errors import errors, run_of
from tests.studies.measured.records import RECORDS, Data
from tests.studies.sindy import CAREFUL, MOST_RIGHT
from tests.studies.sparse import equation, path
from tests.studies.study import Row, StudyError

SETTINGS = {"most right": MOST_RIGHT, "careful": CAREFUL}
PARTICLES, TRAJECTORIES = 200, 50
STARTS = 4  # random ones of each fit to the free run, as a diagnosis makes them
COLUMNS = ("model", "reason", "base", *SETTINGS)
STILL = "no input and no other state moves a state of this model, so there is no equation to search"
IRREGULAR = "its samples are not at one common step, as a regression of the next value needs"
NO_OTHER = "there is no other record to judge on"
LOST = (EngineError, np.linalg.LinAlgError)


def work(name: str, seed: int, run: int) -> Row:
    """One record: what both settings find and what it brings, or the reason why there is nothing.

    Raises StudyError without PySINDy.
    """
    record = RECORDS[name]
    data = record.load(record.path)
    row: Row = {**dict.fromkeys(COLUMNS, ""), "model": data.model.name}
    began = time.perf_counter()
    why = cannot(data)
    if why:
        row["reason"] = why
    else:
        try:
            row |= {key: json.dumps(value) for key, value in judged(data, seed).items()}
        except StudyError:  # without PySINDy: no row, so that it is made once it is there
            raise
        except LOST as error:
            row["reason"] = f"it failed: {error}"
    return row | {"seconds": time.perf_counter() - began}


def cannot(data: Data) -> str:
    """Why a regression has nothing to see; nothing where it has."""
    if not searched(Setting(data.model)):
        return STILL
    if data.train.dt is None:
        return IRREGULAR
    return NO_OTHER if data.blocks or not data.tests else ""


def searched(setting: Setting) -> list[str]:
    """States whose equation is no definition, and that are no mere disturbances."""
    return [name for name in setting.targets if name in setting.moved]


def judged(data: Data, seed: int) -> dict[str, Any]:
    """Errors of the base fitted to the free run; of each setting its names, what was left out, its errors."""
    known = estimated(data)
    names = answers(known, seed)
    parts = telling(known.fit.model, known.fit.theta, known.fit.free, [known.train])
    base = fit_simulation(known.fit.model, parts, known.fit.theta, known.fit.free, STARTS, seed)
    own = judge(base, data, known.substeps)
    done: dict[tuple[str, ...], dict[str, Any]] = {(): {"left_out": [], "errors": own}}
    for terms in names.values():
        if terms not in done:
            done[terms] = extended(known, base, parts, terms, data, seed)
    return {
        "base": own,
        **{label: {"names": terms, **done[terms]} for label, terms in names.items()},
    }


@dataclass(frozen=True, eq=False)
class Estimated:
    """The base model estimated one step ahead on a ``part`` of the record ``train``; both are refined."""

    fit: QuasiFit
    part: Series
    train: Series
    substeps: int

    @property
    def setting(self) -> Setting:
        """For effects of the catalogue."""
        return setting_for(self.fit.model, self.part, np.asarray(self.fit.theta))


def estimated(data: Data) -> Estimated:
    """As a diagnosis does it: on the rows that the likelihood searches, with as many steps a sample."""
    theta, free = data.options.get("theta"), data.options.get("free")
    model, records = records_of(data.model, data.train, next(iter(data.tests.values())))
    part = records.train.part(*rows_searched(model, theta, free, records.train))
    fine = prepare(
        model, records, lambda: np.asarray(fit_base(model, part, theta, free).theta), part
    )
    start = theta if fine.theta is None else fine.theta
    train = fine.records.train
    part = train.part(*rows_searched(model, start, free, train))
    return Estimated(fit_base(model, part, start, free), part, train, fine.k)


def smoothed(known: Estimated, seed: int) -> Array:
    """States (n, nx) at the samples: exact where the model is linear, else by particles."""
    model, theta, part = known.fit.model, known.fit.theta, known.part
    try:
        x = kalman_smoother(model, theta, part).x
    except ModelError:
        filtered = rbpf(model, theta, part, PARTICLES, np.random.default_rng([seed, 1]))
        x = rb_ffbsi(filtered, TRAJECTORIES, np.random.default_rng([seed, 2])).mean()
    return np.asarray(x[part.samples])


def answers(known: Estimated, seed: int) -> dict[str, tuple[str, ...]]:
    """What each setting finds, in all equations. Raises StudyError without PySINDy.

    States count from the zeros that the catalogue has for them: so a term is the effect of its name.
    """
    samples, setting = known.part.held(known.part.hold), known.setting
    states = tuple(setting.states)
    x = smoothed(known, seed) - [setting.zero(state) for state in states]
    found: dict[str, list[str]] = {label: [] for label in SETTINGS}
    step = float(samples.t[1] - samples.t[0])
    for state in searched(setting):
        paths = {
            way: path(equation(x, samples.u, step, states, state, way.target), way)
            for way in {one.way for one in SETTINGS.values()}
        }
        for label, one in SETTINGS.items():
            found[label] += sorted(paths[one.way].answer(one))
    return {label: tuple(terms) for label, terms in found.items()}


def extended(
    known: Estimated,
    base: SimulationFit,
    parts: Sequence[Series],
    terms: Sequence[str],
    data: Data,
    seed: int,
) -> dict[str, Any]:
    """The base model with these terms fitted to the free run; those that it cannot take are left out."""
    setting, model = known.setting.keeping_zeros(), known.fit.model
    left_out, free = [], list(known.fit.free)
    for name in (*constants(terms), *terms):
        try:
            effect = make_effect(name, replace(setting, model=model))
            model = effect.apply(model)
        except LOST:
            left_out.append(name)
        else:
            free += [p.name for p in effect.parameters if p.name not in effect.held]
    start = np.array([*base.theta, *np.asarray(model.theta())[len(base.theta) :]])
    try:
        fit = fit_simulation(model, parts, start, free, STARTS, seed)
    except LOST:
        return {"left_out": left_out, "errors": dict.fromkeys(data.tests)}
    return {"left_out": left_out, "errors": judge(fit, data, known.substeps)}


def constants(terms: Sequence[str]) -> list[str]:
    """The constant of each equation that has a term: the regression always has it, the model may not."""
    targets = [name.partition(":")[2].rpartition("->")[2] for name in terms]
    return [f"force:{target}" for target in dict.fromkeys(targets)]


def judge(fit: SimulationFit, data: Data, substeps: int) -> dict[str, float | None]:
    """The error on each test part; None where the run is lost."""
    theta, rows = np.asarray(fit.theta), data.settled * substeps
    return {
        part: errors(
            series, run_of(fit.model, theta, series.refined(substeps), rows), None, data.settled
        )[0]
        for part, series in data.tests.items()
    }
