"""When causes are looked for again with shorter steps, by what either criterion has found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from engine.diagnose import two_criteria
from engine.diagnose.judging.findings import Verdict
from engine.diagnose.two_criteria import TwoAnswers


def answers(
    k: int, decides: bool, search: Any, steps: int, coarse: bool = False, first: bool = False
) -> TwoAnswers:
    parts: Any = (
        SimpleNamespace(k=k, finer=k < 16),
        SimpleNamespace(
            steps=steps,
            coarse=coarse,
            search=SimpleNamespace(by_the_steps=first),
            verdict=Verdict.UNKNOWN if first else Verdict.NAMED,
        ),
        SimpleNamespace(decides=decides, search=search),
        None,
    )
    return TwoAnswers(*parts, ())


def of_free_run(found: list[str], coarse: bool = False) -> Any:
    return SimpleNamespace(found=found, coarse=coarse)


@pytest.mark.parametrize(
    ("k", "decides", "search", "steps", "again"),
    [
        (2, False, None, 4, True),  # sizes of the likelihood need more
        (2, False, None, 2, False),
        (4, False, None, 8, False),  # sizes are left as they are
        # friction whose steps leave a shape: the free run decides, and has nothing to say
        (2, True, of_free_run([]), 4, True),
        (2, True, of_free_run(["coulomb:v"]), 4, False),  # its names are not the likelihood's
    ],
)
def test_sizes_need_shorter_steps(k, decides, search, steps, again):
    found = answers(k, decides, search, steps)
    assert found.coarse is again
    if again:
        assert found.steps == steps


def test_what_the_free_run_found_does_on_its_own():
    assert answers(4, True, of_free_run(["coulomb:v"], coarse=True), 4).coarse
    assert answers(2, False, None, 2, coarse=True).steps == 4


@pytest.mark.parametrize(("k", "again"), [(1, True), (8, True), (16, False)])
def test_a_search_that_ended_with_its_first_round_is_made_anew(k, again):
    found = answers(k, False, None, 1, coarse=True, first=True)
    assert found.coarse is again
    assert found.steps == 2 * k


def test_a_search_left_half_way_is_no_answer_for_which_an_earlier_one_would_be_kept(monkeypatch):
    """Growth that its own size limits, in samples far apart: a wave in the sensor was adopted for it.

    That had names with long steps, and the next search ended with its first round as steps decide it.
    """
    found = of_free_run(["drift:y"])
    each = {
        1: answers(1, False, found, 2, coarse=True),
        2: answers(2, False, None, 2, coarse=True, first=True),
        4: answers(4, False, of_free_run(["drag:size"]), 4),
    }
    monkeypatch.setattr(two_criteria, "_with_these_steps", lambda _, fine, *rest: each[fine.k])

    def shorter(_: Any, k: int) -> Any:
        return SimpleNamespace(k=k, with_shorter_steps=shorter)

    kept: Any = SimpleNamespace(apart=lambda _: None)
    start: Any = SimpleNamespace(k=1, with_shorter_steps=shorter)
    nothing: Any = None
    both = two_criteria.ask_both(nothing, nothing, start, None, nothing, nothing, kept)
    assert both is each[4]
