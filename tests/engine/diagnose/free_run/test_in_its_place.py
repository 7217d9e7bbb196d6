"""What else a free run could be said by, of one effect of several: the list and the set agree."""

from types import SimpleNamespace

import numpy as np

from engine.diagnose.free_run.answer import _in_its_place, _look_alikes
from engine.diagnose.free_run.search import FreeRound


def test_what_may_stand_in_its_place_beside_others_is_not_said_to_be_ruled_out():
    rng = np.random.default_rng(0)

    def candidate(*names, loss=9.0):
        fit = SimpleNamespace(e=rng.standard_normal(50), n_parameters=2)
        return SimpleNamespace(names=names, fit=fit, losses=loss + 0.1 * rng.standard_normal(16))

    chosen, lost = candidate("offset", "friction", loss=0.0), candidate("drift", "friction")
    other, worst = candidate("drift", "coulomb", loss=0.0), candidate("bias", "friction")
    one = FreeRound(
        SimpleNamespace(e=rng.standard_normal(50)),
        np.zeros(1),
        None,
        (),
        (chosen, lost, other, worst),
        ((chosen,), (other,)),
        0.05,
    )
    instead = _in_its_place(one, SimpleNamespace(name="offset"))
    assert instead == ["drift", "coulomb"]
    listed = _look_alikes(one, SimpleNamespace(name="offset"), instead)
    assert {likeness.effect: likeness.ruled_out for likeness in listed} == {
        "drift": False,
        "bias": True,
    }
