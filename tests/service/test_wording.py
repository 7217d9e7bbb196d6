"""What is said on pages and over HTTP, in words of these."""

import pytest

from engine.presentation.report import make_report
from engine.words import held_by_bounds
from service.problems import invalid
from service.wording import plain_throughout


def test_the_words_of_the_library_are_left_out():
    numbers = [1.0, 2.0]
    told = plain_throughout(
        {"message": held_by_bounds(["k"]), "notes": ["more n_particles"], "t": numbers}
    )
    assert "Parameter(" not in told["message"]
    assert "free=" not in told["message"]
    assert told["message"].endswith("else hold the parameter fixed.")
    assert (told["notes"], told["t"]) == (["more particles"], numbers)
    assert "free=" not in str(invalid("series", "hold parameters fixed (free=)").document())


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"series": [{"file": "run.csv"}]}, "POST /jobs/upload"),
        ({"model": None}, "the name of a model is needed"),
        ({"parameters": {"free": ["theta", "theta"]}}, "'theta' is named twice"),
    ],
)
def test_what_is_wrong_with_a_request_is_told(client, estimation, more, said):
    answer = client.post("/jobs", json=estimation() | more)
    assert answer.status_code == 422
    assert said in answer.text
    assert "Extra inputs" not in answer.text


def test_an_outcome_is_told_once():
    found = {"value": 1.0, "standard_error": None, "unit": "1"}
    document = {"estimate": {"k": found}, "outcome": "converged", "message": "Converged. More."}
    assert str(make_report(document).summary).lower().count("converged") == 1
