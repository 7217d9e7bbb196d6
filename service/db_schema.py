"""The store's tables and its connection settings, for SQLite (WAL) and PostgreSQL."""

from __future__ import annotations

import json
import sqlite3
import stat
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from sqlalchemy import (
    Column,
    Connection,
    Double,
    Engine,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    create_engine,
    event,
    inspect,
    select,
    update,
)
from sqlalchemy.schema import CreateColumn

from service.key_values import found_by

metadata = MetaData()
ITERATIONS = "iterations"  # the stage of a job in which EM iterates
BESIDE = ("-wal", "-shm", "-journal", "-reserve")  # ends of names of what lies beside a SQLite file

# A job, as its status document shows it. ``seq`` is the order of the queue and of the list.
jobs = Table(
    "jobs",
    metadata,
    Column("seq", Integer, primary_key=True, autoincrement=True),
    Column("id", String(32), unique=True, nullable=False),
    Column("kind", String(20), nullable=False),
    Column("model", String(200), nullable=False),
    Column("status", String(20), nullable=False),
    Column("created", Double, nullable=False),
    Column("started", Double),
    Column("updated", Double, nullable=False),
    Column("finished", Double),
    Column("iteration", Integer, nullable=False, default=0),
    Column("iterations", Integer, nullable=False),
    Column("message", Text, nullable=False, default=""),
    Column("estimate", Text),  # JSON {name: value}
    Column("log_likelihood", Double),
    Column("problem", Text),  # JSON problem document of a failed job
    Column("cause", String(60)),  # its kind, for counting
    Column("stages", Text, nullable=False),  # JSON [tasks of the first stage, of the second, ...]
    Column("run_seconds", Double),  # longest run time of a task, if the job sets one
    Column("owner", String(64), nullable=False, default=""),  # name of the API key
    Column("idempotency_key", String(200)),
    Column("digest", String(64)),  # of the request, to compare repeats of an idempotency key
    # what is being done, which share of that is done (null: not known), since when, and from which share
    Column("stage", String(60), nullable=False, server_default=""),
    Column("stage_share", Double),
    Column("stage_begun", Double),
    Column("stage_from", Double),
    # 1: its data are no longer there
    Column("removed", Integer, nullable=False, server_default="0"),
    # what its sender calls it; ``in_lines`` its tags, and the files that its data are from
    Column("name", String(200), nullable=False, server_default=""),
    Column("tags", Text, nullable=False, server_default=""),
    Column("data", Text, nullable=False, server_default=""),
    # of a successful job: its verdict or outcome, and JSON {causes, values}, see ``key_values``
    Column("outcome", String(40)),
    Column("found", Text),
    Index("jobs_status", "status", "seq"),
    UniqueConstraint("owner", "idempotency_key"),
    sqlite_autoincrement=True,
)

# One computation of a job, run by one worker process at a time. Tasks are numbered through the
# job's stages; those of a stage exist once the stage before is done. ``token`` names the attempt
# that may write; a worker with another token has lost the task and stops. ``beat`` counts while somebody
# watches over the attempt.
tasks = Table(
    "tasks",
    metadata,
    Column("job", ForeignKey("jobs.seq", ondelete="CASCADE"), primary_key=True),
    Column("task", Integer, primary_key=True),
    Column("state", String(10), nullable=False),  # queued, running, done, stopped
    Column("token", String(32)),
    Column("holder", String(100)),
    Column("beat", Integer, nullable=False, server_default="0"),
    Column("losses", Integer, nullable=False, default=0),
    # losses without a checkpoint between
    Column("futile", Integer, nullable=False, server_default="0"),
    Column("mark", Integer, nullable=False, server_default="0"),  # checkpoints at the latest loss
    Column("asked", Integer, nullable=False, server_default="0"),  # 1: to leave at a checkpoint
    # attempts taken away since the latest checkpoint, see ``turns``
    Column("taken", Integer, nullable=False, server_default="0"),
    Column("spent", Double, nullable=False, server_default="0"),  # s, of attempts that made room
    Column("iteration", Integer, nullable=False, default=0),
    Index("tasks_state", "state", "job", "task"),
)

# When each key's tasks were last claimed: a number that only grows.
turns = Table(
    "turns",
    metadata,
    Column("owner", String(64), primary_key=True),
    Column("turn", Integer, nullable=False),
)

# One row per iteration: at once progress, checkpoint and trace. ``row`` is float64
# (theta..., log-likelihood, ess, seconds, collapsed), stored as bytes so that a resumed run has the same bits.
iterations = Table(
    "iterations",
    metadata,
    Column("job", ForeignKey("jobs.seq", ondelete="CASCADE"), primary_key=True),
    Column("task", Integer, primary_key=True),
    Column("k", Integer, primary_key=True),
    Column("row", LargeBinary, nullable=False),
    Column("memory", LargeBinary),  # float64, what the next iteration needs besides, if anything
)

# Large JSON, compressed: the request, the result, "task-i", what task i leaves to later stages, and
# "kept-n", what an unfinished diagnosis has finished.
documents = Table(
    "documents",
    metadata,
    Column("job", ForeignKey("jobs.seq", ondelete="CASCADE"), primary_key=True),
    Column("name", String(20), primary_key=True),
    Column("body", LargeBinary, nullable=False),
)

# Written to find out whether the store can be written.
pulse = Table("pulse", metadata, Column("time", Double, primary_key=True))


def in_lines(words: Sequence[str]) -> str:
    """A line for each word, and a line's end before the first, so that a whole word can be searched for."""
    return "".join(f"\n{word}" for word in words) + "\n" if words else ""


def connect(url: str) -> Engine:
    """An engine for the URL with the tables in place; SQLite's folder is made."""
    if url.startswith("sqlite"):
        engine = _sqlite(url)
    else:
        engine = create_engine(url, pool_size=10, max_overflow=20, pool_pre_ping=True)
    metadata.create_all(engine)
    _add_columns(engine)
    return engine


def _sqlite(url: str) -> Engine:
    """An engine that writes ahead, and in whose transactions writers queue."""
    engine = create_engine(url, connect_args={"timeout": 30.0, "check_same_thread": False})
    if engine.url.database:
        _make_private(Path(engine.url.database))

    @event.listens_for(engine, "connect")
    def _connect(connection: sqlite3.Connection, record: Any) -> None:
        connection.isolation_level = None  # transactions begin below, not in the driver
        connection.executescript(
            "PRAGMA auto_vacuum=INCREMENTAL; PRAGMA journal_mode=WAL; PRAGMA synchronous=NORMAL; "
            "PRAGMA foreign_keys=ON"
        )
        # SQLite's own knows the letters of ASCII only
        connection.create_function("lower", 1, _lower, deterministic=True)

    @event.listens_for(engine, "begin")
    def _begin(connection: Any) -> None:
        # A transaction that will write takes its place in the queue of writers at once; one that
        # read first and then found another writer ahead would fail instead of waiting.
        write = connection.get_execution_options().get("write", True)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    return engine


def _lower(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else value


def _make_private(file: Path) -> None:
    """A file that only its owner can read, for it holds everybody's data; one that is there becomes so.

    What SQLite makes beside it gets the same mode.
    """
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    if not file.exists():
        file.touch(mode=0o600)
    for one in (file, *(file.with_name(file.name + suffix) for suffix in BESIDE)):
        with suppress(FileNotFoundError, PermissionError):  # it has gone, or is somebody else's
            if (mode := stat.S_IMODE(one.stat().st_mode)) & 0o077 and one.is_file():
                one.chmod(mode & 0o700)


def _missing(sql: Connection) -> list[Column[Any]]:
    there, missing = inspect(sql), []
    for table in metadata.sorted_tables:
        names = {one["name"] for one in there.get_columns(table.name)}
        missing += [column for column in table.columns if column.name not in names]
    return missing


def _add_columns(engine: Engine) -> None:
    """Give the tables of an earlier version the columns they lack; columns they have too many stay."""
    with engine.execution_options(write=False).begin() as sql:
        if not _missing(sql):
            return
    with engine.begin() as sql:
        if engine.dialect.name != "sqlite":  # where begin() has not locked out other services
            sql.exec_driver_sql("LOCK TABLE jobs, tasks IN ACCESS EXCLUSIVE MODE")
        for column in _missing(sql):
            definition = CreateColumn(column).compile(dialect=engine.dialect)
            sql.exec_driver_sql(f"ALTER TABLE {column.table.name} ADD COLUMN {definition}")
            if column is jobs.c.removed:  # it was removed together with what it had computed
                sql.execute(update(jobs).where(jobs.c.status == "dismissed").values(removed=1))
            if column is jobs.c.found:
                _find(sql)


def _find(sql: Connection) -> None:
    """Note what the jobs of an earlier version have found, from their results."""
    is_result = documents.c.name == "result"
    for seq in sql.scalars(select(documents.c.job).where(is_result)).all():  # one in memory at once
        body = sql.scalar(select(documents.c.body).where(documents.c.job == seq, is_result))
        found = found_by(json.loads(zlib.decompress(body or b"")))
        sql.execute(update(jobs).where(jobs.c.seq == seq).values(found))
