"""A diagnosis shared among processes is the one by a single process, to the last bit."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import engine
from engine import OptionError, Series, forked
from tests.engine.clear_step import clear_flows

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="processes are copied on Linux only"
)
LEVEL = engine.get_model("local-level")
KINDS = ["step", "pulse", "drag"]


def answer(processes, **options):
    found = engine.diagnose(
        LEVEL, clear_flows(), effects=KINDS, seed=1, processes=processes, **options
    )
    document = found.to_dict()
    document["page"] = document["page"].splitlines()[:-1]  # the last tells seconds
    return json.dumps({k: v for k, v in document.items() if "seconds" not in k}, default=str)


@pytest.fixture(scope="module")
def alone():
    return answer(1)


def test_the_answer_does_not_depend_on_their_number(alone, monkeypatch):
    """Of short tasks either."""
    monkeypatch.setattr(forked, "MANY", 2)
    assert answer(3) == alone


@pytest.mark.long
def test_what_was_stopped_goes_on_with_another_number_of_them(alone):
    kept, seen = {}, []

    def stop(stage, share):
        seen.append(stage)
        if stage == "refit" and seen.count("refit") > 2:
            raise StopIteration

    with pytest.raises(StopIteration):
        answer(2, kept=kept, callback=stop)
    assert any("refit" in name for name in kept)
    assert answer(1, kept=kept) == alone


def test_none_and_fractions_are_refused():
    for wrong in (0, 1.5):
        with pytest.raises(OptionError) as error:
            engine.diagnose(LEVEL, Series(np.zeros(40)), processes=wrong)
        assert error.value.field == "processes"
