"""What a free run adds last stays only where it does no worse on data that nothing was fitted to."""

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace as Some

import numpy as np
import pytest

from engine.diagnose.effects.catalogue import make_effect
from engine.diagnose.effects.setting import Setting
from engine.diagnose.free_run.answer import FreeRunSearch, noise_fit
from engine.diagnose.free_run.search import Candidate, FreeRound
from engine.diagnose.free_run_fits.candidates import fit_of
from engine.diagnose.free_run_fits.fitted import Pick, with_effects
from engine.diagnose.held_out import HeldOut
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.records import Records
from engine.errors import ModelError
from engine.estimation.quasi_ml import quasi_ml
from tests.engine.hidden_effects import DRIVE, hidden

COULOMB, SQUARE, OFFSET = "coulomb:speed", "quadratic:speed", "input-offset:force"
THERE = {"coulomb_speed": 0.4, "input_offset_force": 0.5}


def found_in_turn(train, names):
    """A search that has found these effects, one in each round."""
    model, fits = DRIVE, [quasi_ml(DRIVE, train)]
    rounds = []
    for name in names:
        effect = make_effect(name, Setting(DRIVE))
        model = effect.apply(model)
        fits.append(quasi_ml(model, train))
        chosen = Some(names=(name,), added=(effect,))
        rounds.append(FreeRound(None, np.zeros(1), None, (), (), ((chosen,),), 0.05))
    return FreeRunSearch(tuple(rounds), tuple(fits), tuple(fit.log_likelihood for fit in fits))


@pytest.mark.long
@pytest.mark.parametrize(("last", "size", "stays"), [(OFFSET, None, True), (SQUARE, 0.1, False)])
def test_an_addition_that_loses_on_other_data_is_left_out(last, size, stays):
    there = THERE if last == OFFSET else {"coulomb_speed": 0.4}
    train, test = (hidden([COULOMB, OFFSET][: len(there)], there, seed) for seed in (1, 2))
    found = found_in_turn(train, [COULOMB, last])
    if size is not None:  # as one that has bent to the errors of its record
        theta = found.after.theta.asdict() | {"quadratic_speed": size}
        after = replace(found.after, theta=found.after.model.theta(theta))
        found = replace(found, fits=(*found.fits[:-1], after))
    held_out = HeldOut(Records(train, tests=(test,)), train, 0, 0.05)
    left, notes = held_out._borne_out(found)
    assert [one.names for one in left.found] == [(COULOMB,), (last,)][: 1 + stays]
    assert len(left.fits) == len(left.gains) + 1 == len(left.found) + 1
    assert bool(notes) == (not stays)
    if not stays:
        assert COULOMB in notes[0]
        assert last in notes[0]
        assert "m/s rms instead of" in notes[0]


def test_a_survivor_whose_noise_cannot_be_fitted_stands_for_nothing(monkeypatch):
    def cannot(fit):
        raise ModelError("the likelihood is not finite")

    monkeypatch.setattr(import_module("engine.diagnose.free_run.answer"), "noise_fit", cannot)
    groups = tuple((Candidate(None, (), np.zeros(1), 1.0, 0.01, 0.5),) for _ in range(2))
    one = FreeRound(None, np.zeros(1), None, (), (), groups, 0.05)
    found = FreeRunSearch((one,), (None, None), (0.0, 1.0))
    assert not HeldOut(None, None, 0, 0.05)._stands(found, groups[1])


@pytest.mark.long
def test_what_loses_on_other_data_leaves_its_place_to_another_of_its_set():
    train, test = (hidden([COULOMB], {"coulomb_speed": 0.4}, seed) for seed in (1, 2))
    base = fit_of(quasi_ml(DRIVE, train), [train])

    def survivor(name, size):
        effect = make_effect(name, Setting(DRIVE))
        start = with_effects(base, [Pick(effect, size, *effect.probes[:1])])
        bent = start.model.theta({**start.theta.asdict(), effect.size.name: size})
        return Candidate(replace(start, theta=bent), (effect,), np.zeros(1), 1.0, 0.01, 0.5)

    groups = [(survivor(SQUARE, 0.1),), (survivor(COULOMB, 0.4),), (survivor(OFFSET, 1.0),)]
    one = FreeRound(base, np.zeros(1), None, (), (), tuple(groups), 0.05)
    fits = noise_fit(base), noise_fit(groups[0][0].fit)
    found = FreeRunSearch((one,), fits, tuple(fit.log_likelihood for fit in fits))
    assert found.verdict is Verdict.SET
    left, notes = HeldOut(Records(train, tests=(test,)), train, 0, 0.05)._borne_out(found)
    assert left.found[0].names == (COULOMB,)
    assert left.verdict is Verdict.NAMED
    assert SQUARE in notes[0]
    assert COULOMB in notes[0]


@pytest.mark.long
def test_the_only_one_stays_to_be_judged_as_a_whole():
    train, test = (hidden(["coulomb:speed"], {"coulomb_speed": 0.4}, seed) for seed in (1, 2))
    found = found_in_turn(train, [SQUARE])
    left, notes = HeldOut(Records(train, tests=(test,)), train, 0, 0.05)._borne_out(found)
    assert left is found
    assert not notes
