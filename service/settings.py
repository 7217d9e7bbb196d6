"""What an operator can choose; every field can be set by an environment variable ``RBPS_<FIELD>``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter


def _state_dir() -> Path:
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "rbps"


@dataclass(frozen=True)
class Settings:
    """Settings of one service; the defaults are the embedded service on loopback.

    Times are seconds, sizes bytes.
    """

    host: str = "127.0.0.1"
    port: int = 8000
    state_dir: Path = field(default_factory=_state_dir)
    database_url: str = ""  # empty: a SQLite file in state_dir

    keys_file: Path | None = None  # API keys, see auth.py; without it, loopback only
    open_network: bool = False  # listen beyond loopback without keys
    hosts: str = ""  # without keys: further names to answer to, with commas between

    models: str = ""  # own models, with commas between: file.py:name, file.py, or a folder of files
    model_seconds: float = 20.0  # how long a file of own models may take to be looked at

    dask_scheduler: str = ""  # address of a Dask scheduler; without it, attempts run here
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)  # attempts at once
    lease_seconds: float = 15.0  # an attempt whose heartbeat stands still so long is started again
    losses_allowed: int = 2  # how often an attempt whose worker died is started again
    worker_memory: int = 0  # address space of a worker process; 0: no limit
    drain: bool = False  # on shutdown, wait for running attempts; else they go on after the start
    run_seconds: float = 6 * 3600.0  # longest run time of a computation; one that died begins anew
    turn_seconds: float = 60.0  # of a computation, until it makes room for a key that has fewer

    keep_days: float = 0.0  # how long the data of ended jobs are kept; 0: until they are deleted
    max_body: int = 64 * 2**20
    max_series: int = 64
    max_samples: int = 200_000  # of all series of a job together
    max_values: int = 1_000_000  # numbers of a request or a file: all channels of all samples
    max_particles: int = 10_000
    max_iterations: int = 100_000
    max_tasks: int = 1000  # starts, or bootstrap runs, of a job
    max_queue: int = 1000  # jobs that wait or run
    max_queue_per_key: int = 0  # of these, of one key; 0: a quarter
    # samples x iterations x particles of all starts and bootstrap runs of a job
    max_cost: float = 2e10
    body_seconds: float = 30.0  # longest pause within a body; the whole may take 20 times that
    header_seconds: float = 20.0  # a connection has so long to send a request's headers
    max_connections: int = 1000

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"setting port = {self.port}; it must be 0 to 65535")
        seconds = [
            f"{what}_seconds" for what in ("model", "lease", "run", "turn", "body", "header")
        ]
        for name in ("workers", "max_body", "max_queue", "max_connections", *seconds):
            if not getattr(self, name) > 0:
                raise ValueError(f"setting {name} = {getattr(self, name)}; it must be positive")
        if not 0 <= self.max_queue_per_key < self.max_queue:
            raise ValueError(
                f"setting max_queue_per_key = {self.max_queue_per_key}; it must be below max_queue = "
                f"{self.max_queue}, or one key could keep all others out"
            )

    @property
    def queue_per_key(self) -> int:
        """How many jobs of one key may wait or run."""
        return self.max_queue_per_key or max(1, self.max_queue // 4)

    @property
    def own_models(self) -> tuple[str, ...]:
        """The references in ``models``, as they are understood from any folder."""
        return tuple(os.path.abspath(one.strip()) for one in self.models.split(",") if one.strip())

    @property
    def store_url(self) -> str:
        """The store's SQLAlchemy URL."""
        return self.database_url or f"sqlite:///{(self.state_dir / 'rbps.sqlite').absolute()}"

    @classmethod
    def from_env(cls, env: Mapping[str, str] | None = None) -> Settings:
        """Settings from ``RBPS_*``. Raises ValueError naming a variable that is unknown or wrong."""
        env = os.environ if env is None else env
        known = {f"RBPS_{f.name.upper()}": f for f in fields(cls)}
        types = get_type_hints(cls)
        values: dict[str, Any] = {}
        for name, text in env.items():
            if not name.startswith("RBPS_"):
                continue
            if name not in known:
                raise ValueError(f"{name} is not a setting; there are {', '.join(sorted(known))}")
            own = known[name].name
            try:
                values[own] = TypeAdapter(types[own]).validate_python(text)
            except ValueError:
                raise ValueError(f"{name}={text!r} is not of type {known[name].type}") from None
        return cls(**values)
