"""Imported once by the forkserver: worker processes start with the engine and its kernels loaded."""

from __future__ import annotations

import logging

import engine  # noqa: F401
import service.attempt  # noqa: F401

try:
    from engine.warm import warm

    warm()
except Exception:  # the first job will meet the same error and tell its owner
    logging.getLogger("service").exception("the kernels could not be loaded ahead")
