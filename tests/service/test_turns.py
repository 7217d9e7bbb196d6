"""Keys take turns: none keeps all workers while another waits, and nothing is lost by that."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.auth import digest_of
from service.store import Store
from service.turns import Running, Turns


class Clock:
    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def attempts(**owners):
    """So many attempts of each owner: token, owner, not asked, never taken away."""
    return [
        Running(f"{o}{i}", o, asked=False, taken=0) for o, n in owners.items() for i in range(n)
    ]


def asked(running, token, taken=0):
    return [
        Running(one.token, one.owner, True, taken) if one.token == token else one for one in running
    ]


def test_the_key_with_most_is_asked_once_its_turn_is_over(clock):
    turns, running = Turns(60.0, 1000.0, clock), attempts(a=1, b=1)
    turns.look(running, {"c"})
    clock.now = 30.0
    running = attempts(a=3, b=1)
    turns.look(running, {"c"})
    clock.now = 59.0
    assert turns.look(running, {"c"}) == (None, None)
    clock.now = 61.0
    ask, take = turns.look(running, {"c"})
    assert (ask.token, take) == ("a0", None)
    clock.now = 91.0
    assert turns.look(asked(running, "a0"), {"c"}) == (None, None)  # one leaves, and one is enough
    assert turns.look(asked(running, "a0"), {"c", "d"})[0].owner == "a"


@pytest.mark.parametrize("waiting", [(), ("a",), ("a", "b")])
def test_nobody_leaves_for_a_key_that_has_as_many(clock, waiting):
    turns, running = Turns(60.0, 1000.0, clock), attempts(a=2, b=2)
    turns.look(running, waiting)
    clock.now = 900.0
    assert turns.look(running, waiting) == (None, None)


def test_who_finds_no_checkpoint_has_twice_as_long_each_time(clock):
    for taken in range(5):
        turns, running = Turns(60.0, 1e9, clock), attempts(a=1)
        turns.look(running, {"b"})
        waits = asked(running, "a0", taken)
        clock.now += 60.0 * (1 + 2**taken) - 1.0
        assert turns.look(waits, {"b"}) == (None, None)
        clock.now += 1.0
        assert turns.look(waits, {"b"})[1].token == "a0"
        assert turns.look(waits, {"a"}) == (None, None)  # who waited has gone


def test_a_pause_of_the_process_is_nobody_s_turn(clock):
    turns, running = Turns(60.0, 2.0, clock), attempts(a=1)
    turns.look(running, {"b"})
    clock.now = 3600.0
    assert turns.look(running, {"b"}) == (None, None)


@pytest.mark.long
@settings(max_examples=50, deadline=None)
@given(
    places=st.integers(1, 5),
    keys=st.lists(st.tuples(st.integers(0, 40), st.booleans()), min_size=2, max_size=6),
)
def test_no_key_waits_longer_than_the_others_turns(places, keys):
    """Keys come one after another with work without end; some find checkpoints, some never do."""
    clock, turn, step = Clock(), 60.0, 1.0
    turns, running, served = Turns(turn, 10.0, clock), [], {}
    waited, longest, taken, number = {}, 0.0, {}, 0
    for _ in range(int(turn * 40)):
        here = {str(k) for k, (since, _) in enumerate(keys) if clock.now >= since * turn / 4}
        while len(running) < places and here:
            n = {key: sum(one.owner == key for one in running) for key in here}
            key = min(here, key=lambda key: (n[key], served.get(key, 0), key))
            number += 1
            served[key] = number
            running.append(Running(f"{number}", key, asked=False, taken=taken.get(key, 0)))
        ask, take = turns.look(running, here)
        if ask is not None:
            running = asked(running, ask.token, ask.taken)
        for one in list(running):
            checkpoints = keys[int(one.owner)][1]
            if (one.asked and checkpoints) or (take is not None and one.token == take.token):
                running.remove(one)
                taken[one.owner] = 0 if checkpoints else one.taken + 1
        for key in here:
            has = any(one.owner == key for one in running)
            waited[key] = 0.0 if has else waited.get(key, 0.0) + step
            longest = max(longest, waited[key])
        clock.now += step
    assert here == {str(k) for k in range(len(keys))}
    # Each of the others has a turn before, and at most as long again, doubled, without a checkpoint.
    patience = sum(turn * (2.0 + 2.0 ** max(taken.values(), default=0)) for _ in keys)
    assert longest <= patience


def test_an_attempt_leaves_at_a_checkpoint_and_only_there(store):
    store.create("estimate", "m", {}, 10, owner="a", run_seconds=100.0)
    attempt = store.claim("x")
    row = np.arange(6.0)
    assert store.record(attempt, 1, {1: row}, ran=1.0)  # nobody has asked
    store.ask(attempt.token)
    assert store.record(attempt, 2, {2: row})  # no place to leave
    assert store.holds(attempt)
    assert not store.record(attempt, 3, {3: row}, ran=2.5)
    assert not store.holds(attempt)
    assert store.rows(attempt.job)[0] == [1, 2, 3]
    assert store.job(attempt.job_id).message == "paused for other jobs; resumes where it was"
    again = store.claim("x")
    assert (again.job, again.spent, again.run_seconds) == (attempt.job, 2.5, 100.0)
    assert store.keep(again, 0, "part", ran=1.0)  # the question was to the other
    store.ask(again.token)
    assert not store.keep(again, 1, "part", ran=1.0)
    assert store.kept(attempt.job) == ["part", "part"]
    third = store.claim("x")
    assert third.spent == 3.5
    ((task, _),) = store.tasks(attempt.job)
    assert (task.losses, task.futile, task.taken) == (0, 0, 0)


def test_what_is_taken_away_is_counted_until_a_checkpoint(store):
    store.create("estimate", "m", {}, 10, owner="a")
    for taken in range(3):
        attempt = store.claim("x")
        running, waiting = store.standing()
        assert (running, waiting) == ([Running(attempt.token, "a", False, taken)], set())
        store.ask(attempt.token)
        assert store.standing()[0][0].asked
        store.take(attempt.token)
        store.take(attempt.token)  # as another service of the store may, too
        assert not store.record(attempt, 1, {1: np.zeros(1)}, ran=1.0)
        assert store.standing() == ([], {"a"})
    attempt = store.claim("x")
    store.ask(attempt.token)
    assert not store.record(attempt, 1, {1: np.zeros(1)}, ran=1.0)
    assert store.claim("x").spent == 1.0
    assert store.standing()[0][0].taken == 0


def test_who_made_room_comes_after_those_it_was_for(store):
    """Not before them because its jobs are older; nor does a key with many jobs."""
    for owner in "aaabbc":
        store.create("estimate", "m", {}, 1, owner=owner)
    order = []
    for _ in range(9):
        attempt = store.claim("x")
        order.append(attempt.job)
        store.ask(attempt.token)
        assert not store.record(attempt, 1, {len(order): np.zeros(1)}, ran=1.0)
    assert order == [1, 4, 6] * 3


@pytest.mark.slow
def test_a_key_that_comes_later_is_not_kept_waiting(make_client, tmp_path, long, estimation, wait):
    """One worker, and a computation of another key far longer than any test."""
    anna, bert = keyed(make_client, tmp_path, turn_seconds=0.2)
    slow = anna("POST", "/jobs", json=long).headers["location"]
    wait(Caller(anna), slow, lambda job: job["iteration"] >= 1)
    url = bert("POST", "/jobs", json=estimation()).headers["location"]
    job = wait(Caller(bert), url, lambda job: job["status"] not in ("accepted", "running"))
    assert job["status"] == "successful", job["message"]
    before = anna("GET", slow).json()
    assert before["status"] == "running"
    assert before["iteration"] >= 1
    wait(Caller(anna), slow, lambda job: job["iteration"] > before["iteration"])
    anna("POST", f"{slow}/stop")


@pytest.mark.slow
def test_turns_change_no_bit(make_client, tmp_path, client, estimation, ended):
    request = estimation(particles=100, iterations=200, seed=9)
    alone = client.post("/jobs", json=request).headers["location"]
    ended(client, alone)
    callers = keyed(make_client, tmp_path, turn_seconds=0.2)
    urls = [call("POST", "/jobs", json=request).headers["location"] for call in callers]
    found = []
    for call, url in zip(callers, urls, strict=True):
        assert ended(Caller(call), url)["status"] == "successful"
        found.append(call("GET", f"{url}/results").json())
    expected = client.get(f"{alone}/results").json()
    for one in (*found, expected):
        del one["trace"]["seconds"], one["created"]
    assert found == [expected, expected]
    store = Store(f"sqlite:///{tmp_path}/rbps.sqlite")
    tasks = [task for seq in (1, 2) for task, _ in store.tasks(seq)]
    store.close()
    assert any(task.spent > 0 for task in tasks), "none has made room"
    assert all(task.losses == 0 for task in tasks)


def keyed(make_client, folder, **more):
    """Two callers of one service with one worker."""
    lines = [f"{name} {digest_of(name)}\n" for name in ("anna", "bert")]
    (folder / "keys").write_text("".join(lines))
    served = make_client(keys_file=folder / "keys", workers=1, **more)

    def caller(name):
        return lambda verb, url, **rest: served.request(
            verb, url, headers={"X-API-Key": name}, **rest
        )

    return caller("anna"), caller("bert")


class Caller:
    """A client for ``wait``."""

    def __init__(self, call):
        self.get = lambda url: call("GET", url)
