"""What is said while a computation is kept: per cent, and the time left of a stage whose steps are counted."""

from types import SimpleNamespace

import pytest

from service.cli import parts
from service.cli.meter import Meter


class Told(Meter):
    def __init__(self):
        self.words = []

    def at(self, done, text=""):
        self.words.append((done, text))


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(parts.time, "monotonic", lambda: now.s)
    return now


def test_the_time_left_of_a_stage_goes_by_its_own_pace(clock):
    shown = Told()
    kept = parts.Kept(SimpleNamespace(due=False), shown)
    for seconds, k, message, share in [
        (0, 3, "screening effects, 0 % of them", 0.0),
        (10, 5, "screening effects, 5 % of them", 0.05),
        (10, 9, "screening effects, 50 % of them", 0.5),
        (1, 9, "searching with the free run", None),
        (0, 9, "estimating the most likely effects, 20 % of them", 0.2),
        (60, 20, "estimating the most likely effects, 60 % of them", 0.6),
    ]:
        clock.s += seconds
        kept.step(k, message, share)
    left = [text.partition(" of them")[2] for _, text in shown.words]
    assert left == ["", "", ", about 20 s left of this", "", "", ", about 60 s left of this"]
    assert [k for k, _ in shown.words] == [3, 5, 9, 9, 9, 20]
