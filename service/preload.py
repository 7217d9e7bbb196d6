"""Imported once by the forkserver: worker processes start with the engine and its kernels loaded."""

from __future__ import annotations

import logging

from service.orphans import die_with_parent

die_with_parent()  # before what takes seconds, or on a new machine minutes: nobody is asked meanwhile

import engine  # noqa: E402, F401
import service.attempt  # noqa: E402, F401

try:
    from engine.warm import warm

    warm()
except Exception:  # the first job will meet the same error and tell its owner
    logging.getLogger("service").exception("the kernels could not be loaded ahead")
