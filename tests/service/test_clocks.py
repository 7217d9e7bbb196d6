"""Clocks that only count while their process is awake."""

from hypothesis import given, settings
from hypothesis import strategies as st

from service.clocks import Awake, Silence


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_a_pause_of_the_process_counts_little():
    clock = Clock()
    awake = Awake(2.0, clock)
    for step, seconds in ((1.0, 1.0), (3600.0, 3.0), (0.5, 3.5)):
        clock.now += step
        assert awake.look() == seconds


def test_silence_is_told_after_its_time_and_not_before():
    clock = Clock()
    silence = Silence(4.0, clock)
    assert silence.look({"a": 1, "b": 1}) == {}
    for beat in range(2, 6):
        clock.now += 1.0
        assert silence.look({"a": beat, "b": 1}) == {}
    clock.now += 0.1
    assert silence.look({"a": 6, "b": 1}) == {"b": 1}
    assert silence.look({"a": 6}) == {}
    assert silence.look({"b": 1}) == {}  # another attempt's token begins anew


@settings(deadline=None, derandomize=True)
@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=30))
def test_whatever_pauses_there_are_four_looks_are_needed(pauses):
    clock = Clock()
    silence = Silence(4.0, clock)
    silence.look({"a": 1})
    for i, pause in enumerate(pauses):
        clock.now += pause
        silent = silence.look({"a": 1})
        assert i >= 4 or not silent
        assert silent or sum(min(one, 1.0) for one in pauses[: i + 1]) <= 4.0 + 1e-9
