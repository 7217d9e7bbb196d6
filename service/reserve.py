"""A little space that is kept free for freeing more: to delete from a database takes room too."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

RESERVE_BYTES = 4 << 20  # bytes


class Reserve:
    """A file beside a SQLite database that is given up when the disk is full; None: there is none."""

    def __init__(self, database: str | None) -> None:
        self._file = Path(f"{database}-reserve") if database else None
        self.fill()

    def fill(self) -> None:
        """Take the space again, where there is some."""
        if self._file is None or self._file.exists():
            return
        with suppress(OSError):
            descriptor = os.open(self._file, os.O_CREAT | os.O_WRONLY, 0o600)
            try:
                os.posix_fallocate(descriptor, 0, RESERVE_BYTES)
            except OSError:
                self._file.unlink()
            finally:
                os.close(descriptor)

    def give_up(self) -> bool:
        """Free the space; whether there was any."""
        if self._file is None:
            return False
        try:
            self._file.unlink()
        except OSError:
            return False
        return True
