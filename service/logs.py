"""Logs as JSON lines, or as plain text on a terminal; ``job`` is there where there is one."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections import Counter


class JsonLines(logging.Formatter):
    """One JSON object per record."""

    def format(self, record: logging.LogRecord) -> str:
        """{"time", "level", "logger", "message", "job"?, "error"?}."""
        moment = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        line = {
            "time": f"{moment}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if job := getattr(record, "job", None):
            line["job"] = job
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line)


class Sparse(logging.Filter):
    """Of warnings and errors of one place, few a minute: a client could fill the disk with them."""

    def __init__(self, most: int = 5, seconds: float = 60.0) -> None:
        super().__init__()
        self._most, self._seconds = most, seconds
        self._begun: dict[object, float] = {}
        self._count: Counter[object] = Counter()

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to write the record; the first of another minute says how many were left out."""
        if record.levelno < logging.WARNING:
            return True
        place = (record.name, record.lineno, str(record.msg).partition("\n")[0])
        now = time.monotonic()
        if now - self._begun.setdefault(place, now) > self._seconds:
            if (left_out := self._count[place] - self._most) > 0:
                record.msg = f"{record.msg} ({left_out} more like this were not written)"
            self._begun[place], self._count[place] = now, 0
        self._count[place] += 1
        return self._count[place] <= self._most


def configure() -> None:
    """Log to standard error."""
    handler = logging.StreamHandler()
    handler.addFilter(Sparse())
    if not sys.stderr.isatty():
        handler.setFormatter(JsonLines())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.getLogger("uvicorn.access").setLevel(logging.WARNING)  # polling clients fill the log
