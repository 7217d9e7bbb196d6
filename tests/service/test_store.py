"""The store alone, on SQLite and on PostgreSQL: who may write, what follows what, who waits."""

import json
import threading
import time
from itertools import chain

import numpy as np
import pytest

from service import stages
from service.attempt import StoredParts
from service.clocks import Silence
from service.lookup import find_result, has_estimates, stopped_estimate
from service.problems import Problem
from service.store import Store
from service.validation import load


@pytest.mark.long
def test_an_attempt_that_lost_its_task_cannot_write(store):
    job_id = store.create("estimate", "linear-2", {}, 10)
    first = store.claim("one")
    assert store.claim("two") is None
    assert store.expire(store.beats(), losses_allowed=2) == 1
    second = store.claim("two")
    assert second.task == first.task
    assert not store.record(first, 1, {})
    assert not store.finish(first, {"mine": 1})
    assert not store.fail(first, {"detail": "mine"})
    assert not store.renew(first)
    assert not store.lost(first, "gone", 2)
    assert store.renew(second)
    assert store.finish(second, {"mine": 2})
    assert store.document(second.job, "result") == b'{"mine":2}'
    assert store.job(job_id).status == "successful"
    assert not store.finish(second, {"mine": 3})


@pytest.mark.parametrize("hours", [-1000, -1, 1, 1000])
def test_a_wall_clock_that_is_set_changes_nothing(store, monkeypatch, hours):
    """Neither is a task lost whose heart beats, nor one kept whose heart stands still."""
    store.create("estimate", "linear-2", {}, 10, stages=[2])
    alive, gone = store.claim("one"), store.claim("two")
    now = [0.0]
    silence = Silence(15.0, lambda: now[0])
    silence.look(store.beats())
    wall = time.time
    monkeypatch.setattr(time, "time", lambda: wall() + 3600.0 * hours)
    for _ in range(20):
        now[0] += 1.0
        assert store.renew(alive)
        silent = silence.look(store.beats())
    assert list(silent) == [gone.token]
    assert store.expire(silent, 2) == 1
    assert store.holds(alive)
    assert store.claim("three").task == gone.task


def test_a_heartbeat_that_went_on_meanwhile_is_no_loss(store):
    store.create("estimate", "linear-2", {}, 10)
    attempt = store.claim("one")
    silent = store.beats()
    assert store.renew(attempt)
    assert store.expire(silent, 2) == 0
    assert store.holds(attempt)


def test_the_store_of_an_earlier_version_is_taken_over(store):
    waiting = store.create("estimate", "linear-2", {"n": 1}, 10)
    dismissed = store.create("estimate", "linear-2", {"n": 1}, 10)
    store.stop(dismissed)
    with store._engine.begin() as sql:
        for table, column in (
            ("tasks", "beat"),
            ("tasks", "futile"),
            ("tasks", "mark"),
            ("tasks", "asked"),
            ("tasks", "taken"),
            ("tasks", "spent"),
            ("jobs", "removed"),
        ):
            sql.exec_driver_sql(f"ALTER TABLE {table} DROP COLUMN {column}")
        sql.exec_driver_sql("DROP TABLE turns")
        sql.exec_driver_sql("ALTER TABLE tasks ADD COLUMN lease_until DOUBLE PRECISION")
    newer = Store(store.url)
    assert [newer.job(one).removed for one in (waiting, dismissed)] == [0, 1]
    attempt = newer.claim("one")
    assert newer.beats() == {attempt.token: 1}
    assert newer.renew(attempt)
    assert newer.finish(attempt, {})
    newer.close()


def test_what_an_attempt_keeps_is_there_for_the_next_and_goes_with_the_job(store):
    store.create("diagnose", "linear-2", {}, 100)
    first = store.claim("one")
    assert store.keep(first, 0, "0")
    assert store.keep(first, 1, '{"at": NaN}')
    assert store.lost(first, "killed", 2)
    second = store.claim("two")
    assert not store.keep(first, 2, "late")
    assert store.keep(second, 2, "2")
    assert store.kept(second.job) == ["0", '{"at": NaN}', "2"]
    assert store.finish(second, {"mine": 2})
    assert store.kept(second.job) == []
    assert store.document(second.job, "result") == b'{"mine":2}'


def test_parts_of_another_version_or_of_before_it_was_begun_anew_are_left_alone(store, monkeypatch):
    store.create("diagnose", "linear-2", {}, 100)
    first = store.claim("one")
    parts = StoredParts(store, first)
    parts["asked"], parts["fit"], parts["screen"] = "one model", 1, 2
    assert dict(StoredParts(store, first)) == parts == {"asked": "one model", "fit": 1, "screen": 2}
    parts.clear()  # the model has changed
    parts["asked"], parts["fit"] = "another model", 3
    assert dict(StoredParts(store, first)) == {"asked": "another model", "fit": 3}
    monkeypatch.setattr("service.attempt.version", lambda name: "0.0.1")
    newer = StoredParts(store, first)
    assert newer == {}
    newer["asked"] = "this version's"
    assert dict(StoredParts(store, first)) == {"asked": "this version's"}
    store.lost(first, "killed", 2)
    with pytest.raises(SystemExit):
        newer["fit"] = 4


def test_stages_follow_each_other_whoever_runs_them(store, estimation):
    """Two attempts at once, one lost and taken up again: each stage once, in order."""
    request = estimation(method="rts-em", iterations=3, starts=2, bootstrap=2)
    job = load(request)
    plan = stages.plan(job.request)
    assert plan == [2, 1, 2, 1]
    made = store.create("estimate", "linear-2", request, 12, plan)
    first, second = store.claim("a"), store.claim("b")
    assert (first.task, second.task) == (0, 1)
    assert store.claim("c") is None
    assert store.lost(first, "killed", 2)
    first = store.claim("a")
    assert first.task == 0
    assert store.finish(second, {"n": 1})
    assert store.claim("c") is None
    assert store.finish(first, {"n": 0})
    choose = store.claim("c")
    assert choose.task == 2
    assert store.claim("d") is None
    assert json.loads(store.document(choose.job, "task-1")) == {"n": 1}
    assert store.finish(choose, {"n": 2})
    third, fourth = store.claim("a"), store.claim("b")
    assert (third.task, fourth.task) == (3, 4)
    assert store.finish(third, {})
    assert store.finish(fourth, {})
    assert store.job(made).status == "running"
    assert store.finish(store.claim("a"), {"n": 5})
    assert store.job(made).status == "successful"


def test_the_status_of_a_finished_estimation_tells_its_estimate(store):
    """Not the last iterate, which may be another, nor the likelihood of one filter there."""
    made = store.create("estimate", "linear-2", {}, 10)
    attempt = store.claim("a")
    assert store.record(attempt, 1, {}, {"theta": 0.9}, -77.0)
    assert json.loads(store.job(made).estimate) == {"theta": 0.9}
    estimate = {"theta": {"value": 0.3, "standard_error": None, "unit": "1"}}
    likelihood = {"value": -75.5, "standard_error": 0.1}
    result = {"estimate": estimate, "log_likelihood": likelihood, "trace": {}}
    assert store.finish(attempt, result)
    assert json.loads(store.job(made).estimate) == {"theta": 0.3}
    assert store.job(made).log_likelihood == -75.5


def test_many_claim_and_each_task_is_given_once_in_order(store):
    made = [store.create("simulate", "linear-2", {}, 1) for _ in range(40)]
    claimed, errors = {str(i): [] for i in range(8)}, []

    def claim(name):
        try:
            while (attempt := store.claim(name)) is not None:
                claimed[name].append(made.index(attempt.job_id))
                assert store.finish(attempt, {"by": name})
        except Exception as error:  # noqa: BLE001 - shown by the assertion below
            errors.append(error)

    threads = [threading.Thread(target=claim, args=(name,)) for name in claimed]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert sorted(chain.from_iterable(claimed.values())) == list(range(40))
    assert all(own == sorted(own) for own in claimed.values())  # however long one of them rests


def test_the_key_with_fewest_attempts_goes_first_and_its_oldest_job(store):
    """One job with many tasks, or many jobs of one key, keep nobody else waiting."""
    for owner, n in (("a", 3), ("a", 1), ("b", 2), ("c", 1)):
        store.create("estimate", "linear-2", {}, 10, stages=[n], owner=owner)
    order = [store.claim("x") for _ in range(7)]
    assert [(one.job, one.task) for one in order] == [
        (1, 0), (3, 0), (4, 0),  # one of each key
        (1, 1), (3, 1), (1, 2), (2, 0),
    ]  # fmt: skip
    assert store.claim("x") is None


def test_limits_of_the_queue_and_who_is_not_counted_by_them(store):
    most = [(None, 3), ("a", 2)]
    first = store.create("simulate", "m", {}, 1, owner="a", idempotency_key="k", most=most)
    store.create("simulate", "m", {}, 1, owner="a", most=most)
    with pytest.raises(Problem, match="2 jobs wait"):
        store.create("simulate", "m", {}, 1, owner="a", most=most)
    again = store.create("simulate", "m", {}, 1, owner="a", idempotency_key="k", most=most)
    assert again == first  # its job is there, however full the queue is
    with pytest.raises(Problem, match="came with another request"):
        store.create("simulate", "m", {"n": 2}, 1, owner="a", idempotency_key="k", most=most)
    store.create("simulate", "m", {}, 1, owner="b", most=[(None, 3), ("b", 2)])
    with pytest.raises(Problem, match="3 jobs wait"):
        store.create("simulate", "m", {}, 1, owner="c", most=[(None, 3), ("c", 2)])
    store.stop(first)
    store.create("simulate", "m", {}, 1, owner="a", most=most)
    with pytest.raises(Problem, match="jobs wait"):
        store.resume(first, most)
    assert store.job(first).status == "dismissed"


def test_no_more_jobs_than_allowed_however_many_come_at_once(tmp_path):
    store, results = Store(f"sqlite:///{tmp_path}/a.sqlite"), []

    def create():
        try:
            results.append(store.create("simulate", "m", {}, 1, most=[(None, 5)]))
        except Problem:
            results.append(None)

    threads = [threading.Thread(target=create) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(one is not None for one in results) == 5
    store.close()


WRITERS = {
    "record": lambda store, attempt: store.record(attempt, 1, {}),
    "finish": lambda store, attempt: store.finish(attempt, {}),
    "fail": lambda store, attempt: store.fail(attempt, {"detail": "no"}),
    "lost": lambda store, attempt: store.lost(attempt, "killed", 2),
    "expire": lambda store, attempt: store.expire({attempt.token: 1}, 2),
    "stop": lambda store, attempt: store.stop(attempt.job_id),
    "keep": lambda store, attempt: store.keep(attempt, 0, "part", ran=1.0),
    "take": lambda store, attempt: store.take(attempt.token),
}


@pytest.mark.long
@pytest.mark.parametrize("name", WRITERS)
def test_who_waits_for_a_job_holds_none_of_its_tasks(postgres, eventually, name):
    """Locks are taken in one order, job before task, so that no two writers wait for each other."""
    store = Store(postgres)
    try:
        store.create("estimate", "linear-2", {}, 10)
        attempt = store.claim("a")
        writer = threading.Thread(target=WRITERS[name], args=(store, attempt))
        waiting = "SELECT count(*) FROM pg_locks WHERE NOT granted"
        with store._engine.begin() as sql:
            sql.exec_driver_sql(f"SELECT * FROM jobs WHERE seq = {attempt.job} FOR UPDATE")
            writer.start()
            with store._engine.begin() as other:
                eventually(lambda: other.exec_driver_sql(waiting).scalar())
                other.exec_driver_sql(
                    f"SELECT * FROM tasks WHERE job = {attempt.job} FOR UPDATE NOWAIT"
                )
        writer.join()
    finally:
        with store._engine.begin() as sql:
            sql.exec_driver_sql("TRUNCATE jobs CASCADE")
        store.close()


def test_iterations_come_back_with_the_same_bits(store):
    store.create("estimate", "linear-2", {}, 10)
    attempt = store.claim("a")
    rng = np.random.default_rng(0)
    rows = {k: np.append(rng.standard_normal(4), np.nan) for k in range(5)}
    assert store.record(attempt, 2, {k: rows[k] for k in (0, 1, 2)})
    assert store.record(attempt, 4, {k: rows[k] for k in (3, 4)}, {"theta": 0.5}, float("nan"))
    ks, found = store.rows(attempt.job)
    assert ks == list(rows)
    assert found.tobytes() == np.array(list(rows.values())).tobytes()
    assert store.rows(attempt.job, after=3)[0] == [4]
    job = store.job(attempt.job_id)
    assert (job.iteration, job.log_likelihood) == (4, None)


def test_a_key_names_one_job_however_many_ask(store):
    made = []

    def create(i):
        made.append(store.create("simulate", "m", {"n": 1}, 1, idempotency_key="k", owner="o"))

    threads = [threading.Thread(target=create, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 8
    assert len(set(made)) == 1
    assert store.create("simulate", "m", {"n": 2}, 1, idempotency_key="k", owner="p") != made[0]
    with pytest.raises(Problem, match=made[0]):
        store.create("simulate", "m", {"n": 2}, 1, idempotency_key="k", owner="o")


def lose(store, rows=(), parts=()):
    """An attempt that writes iterations or finished parts of a diagnosis, and is lost."""
    attempt = store.claim("a")
    if rows:
        assert store.record(attempt, max(rows), {k: np.zeros(5) for k in rows})
    for n in parts:
        assert store.keep(attempt, n, "{}")
    assert store.lost(attempt, "killed", 2)
    return store.job(attempt.job_id)


@pytest.mark.parametrize("what", ["rows", "parts"])
def test_losses_count_only_where_nothing_was_reached_between_them(store, what):
    store.create("estimate", "linear-2", {}, 100)
    for i in range(5):  # far more than are allowed
        job = lose(store, **{what: [2 * i + 1, 2 * i + 2]})
        assert (job.status, "(restart 1 of 2)" in job.message) == ("running", True)
    assert "(restart 2 of 2)" in lose(store).message
    job = lose(store)
    assert (job.status, job.message) == ("failed", "killed; given up after 3 attempts")
    ((task, _),) = store.tasks(job.seq)
    assert task.losses == 6


def test_a_loss_before_the_first_checkpoint_counts(store):
    store.create("estimate", "linear-2", {}, 100)
    assert "(restart 1 of 2)" in lose(store, rows=[0]).message  # row 0 is the start
    assert "(restart 2 of 2)" in lose(store).message
    assert lose(store).status == "failed"


def test_no_loss_is_allowed_where_none_is(store):
    store.create("estimate", "linear-2", {}, 100)
    attempt = store.claim("a")
    assert store.record(attempt, 3, {3: np.zeros(5)})
    assert store.expire(store.beats(), losses_allowed=0) == 1
    assert store.job(attempt.job_id).status == "failed"


def begun(store):
    attempt = store.claim("a")
    assert store.record(attempt, 1, {0: np.zeros(5), 1: np.ones(5)}, {"theta": 0.5}, 1.0)
    return attempt


def fails(store, made):
    attempt = begun(store)
    assert store.fail(attempt, {"detail": "no"})
    assert not store.record(attempt, 2, {2: np.ones(5)})
    return [0, 1]


def is_lost(store, made):
    for _ in range(3):
        lose(store)
    return []


def test_a_job_whose_time_is_up_before_it_has_anything_says_why(store, estimation):
    made = store.create("estimate", "linear-2", estimation(iterations=5), 5, run_seconds=4.0)
    store.fail(
        store.claim("a"), Problem(422, "run-time-exceeded", "took longer than 4 s").document()
    )
    with pytest.raises(Problem, match="took longer than 4 s") as told:
        find_result(store, store.job(made))
    assert told.value.document()["type"].endswith("run-time-exceeded")


def test_a_job_whose_time_is_up_keeps_what_it_has_and_is_given_more(store, estimation):
    request = estimation(iterations=5)
    made = store.create("estimate", "linear-2", request, 5, run_seconds=4.0)
    attempt = store.claim("a")
    store.record(attempt, 1, {0: np.zeros(5), 1: np.append(0.25, -np.ones(4))})
    for cause, kept in (("computation-failed", False), ("run-time-exceeded", True)):
        store.fail(attempt, Problem(422, cause, "took longer than 4 s; it can go on").document())
        reached = stopped_estimate(store, store.job(made))
        assert (reached is not None) == kept
        store.resume(made)
        attempt = store.claim("a")
        assert attempt.run_seconds == 4.0
    assert (reached["outcome"], reached["estimate"]["theta"]["value"]) == ("stopped", 0.25)
    told = f"took longer than 4 s; it can go on (POST /jobs/{made}/resume with more run_seconds)"
    assert reached["message"] == f"Stopped after 1 of at most 5 iterations: {told}."

    store.show(attempt, {"estimate": {}})
    store.fail(attempt, Problem(422, "run-time-exceeded", "x").document())
    assert has_estimates(store, store.job(made))
    assert find_result(store, store.job(made)) == b'{"estimate":{}}'
    store.resume(made, run_seconds=60.0)
    attempt = store.claim("a")
    assert attempt.run_seconds == 60.0
    store.fail(attempt, Problem(422, "computation-failed", "x").document())
    assert not has_estimates(store, store.job(made))
    with pytest.raises(Problem, match="x"):
        find_result(store, store.job(made))


def is_stopped(store, made):
    attempt = begun(store)
    assert store.stop(made)
    assert not store.record(attempt, 2, {2: np.ones(5)})
    return [0, 1]


def is_stopped_in_the_queue(store, made):
    assert store.stop(made)
    return []


@pytest.mark.long
@pytest.mark.parametrize("ends", [fails, is_lost, is_stopped, is_stopped_in_the_queue])
def test_what_ended_before_its_result_goes_on(store, ends):
    made = store.create("estimate", "linear-2", {"n": 1}, 100, stages=[2, 1])
    done = store.claim("a")
    assert store.finish(done, {"task": 0})
    kept = ends(store, made)  # iterations
    assert store.claim("a") is None
    resumed = store.resume(made)
    assert (resumed.status, resumed.problem, resumed.finished) == ("accepted", None, None)
    assert store.resume(made).status == "accepted"  # and once more: no difference
    again = store.claim("a")
    assert (again.task, store.job(made).status) == (1, "running")
    assert store.rows(again.job, 1)[0] == kept
    assert "(restart 1 of 2)" in lose_again(store, again).message  # losses are counted anew
    assert store.finish(store.claim("a"), {"task": 1})
    assert store.finish(store.claim("a"), {"result": 1})
    assert store.job(made).status == "successful"
    assert store.resume(made).status == "successful"
    assert store.claim("a") is None


def lose_again(store, attempt):
    assert store.lost(attempt, "killed", 2)
    return store.job(attempt.job_id)


def test_a_stopped_job_keeps_its_data_and_a_removed_one_does_not(store):
    made = store.create("estimate", "linear-2", {"y": [1, 2]}, 10)
    attempt = store.claim("a")
    assert store.record(attempt, 1, {0: np.zeros(5), 1: np.ones(5)}, {"theta": 0.5}, 1.0)
    assert store.keep(attempt, 0, "part")
    for _ in range(2):
        assert (store.stop(made).status, store.job(made).removed) == ("dismissed", 0)
    assert not store.holds(attempt)
    assert not store.record(attempt, 2, {2: np.zeros(5)})
    assert store.document(attempt.job, "request") == b'{"y":[1,2]}'
    assert store.kept(attempt.job) == ["part"]
    assert (store.rows(attempt.job)[0], store.job(made).estimate) == ([0, 1], '{"theta":0.5}')

    assert (store.dismiss(made).status, store.job(made).removed) == ("dismissed", 1)
    assert store.document(attempt.job, "request") is None
    assert store.kept(attempt.job) == []
    assert (store.rows(attempt.job)[0], store.job(made).estimate) == ([], None)
    assert store.resume(made).status == store.stop(made).status == "dismissed"
    assert store.claim("a") is None
    assert store.stop("none") is store.dismiss("none") is None
    assert store.resume("none") is None
    assert store.counts() == {"dismissed": 1}
    store.check()


@pytest.mark.slow
def test_the_service_on_any_store(database, make_client, estimation, ended):
    client = make_client(database_url=database, workers=2)
    assert client.get("/readyz").status_code == 200
    request = estimation(method="rts-em", iterations=10, starts=3)
    urls = [client.post("/jobs", json=request).headers["location"] for _ in range(2)]
    found = []
    for url in urls:
        job = ended(client, url)
        assert job["status"] == "successful", job["message"]
        found.append(client.get(f"{url}/results").json()["estimate"])
    assert found[0] == found[1]
    assert 'rbps_jobs{status="successful"} 2' in client.get("/metrics").text
