"""Errors as RFC 9457 problem documents (``application/problem+json``)."""

from __future__ import annotations

import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.wording import plain, plain_throughout

if TYPE_CHECKING:
    from starlette.responses import JSONResponse

MEDIA_TYPE = "application/problem+json"
# The two problems that OGC API - Processes names keep the identifiers clients know.
_OGC = "http://www.opengis.net/def/exceptions/ogcapi-processes-1/1.0/"
_TYPES = {kind: _OGC + kind for kind in ("no-such-job", "result-not-ready")}

OUT_OF_TIME = "run-time-exceeded"  # of a job that nothing else was wrong with

# What the owner of a failed job can do; DIVERGED and COLLAPSED say so themselves.
ADVICE = {
    "computation-failed": "Check the start values, the units of the data and the time step; if they are "
    "right, start elsewhere or hold some parameters fixed.",
    "no-start-succeeded": "Give ranges (parameters.ranges) around values that are physically plausible, or "
    "use more particles.",
    "not-finite": "Check the parameter values, the scale of the inputs and the time step.",
    "out-of-memory": "Use fewer particles or trajectories, or split the data into shorter series.",
    OUT_OF_TIME: "Resume it and allow more time (run_seconds of POST /jobs/<id>/resume): it goes on where it "
    "was. Or use fewer iterations, particles or starts.",
    "worker-lost": "Send the job again; if it is lost again, it probably needs more memory than the machine "
    "has: use fewer particles.",
}


class Problem(Exception):  # noqa: N818 - the RFC's own word
    """An error the client is told about.

    ``kind`` ends the problem's type; ``errors`` lists {field, message, row?, channel?}.
    """

    def __init__(
        self,
        status: int,
        kind: str,
        detail: str,
        errors: Sequence[dict[str, Any]] = (),
        retry_after: float | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status, self.kind, self.detail = status, kind, plain(detail)
        self.errors: list[dict[str, Any]] = plain_throughout(list(errors))
        self.headers = dict(headers or {})
        if retry_after is not None:
            self.headers["Retry-After"] = str(max(1, round(retry_after)))

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Problem:
        """The problem of a stored document."""
        kind = str(document["type"]).rpartition(":")[2]
        return cls(document["status"], kind, document["detail"], document.get("errors", ()))

    def document(self) -> dict[str, Any]:
        """The JSON body."""
        body: dict[str, Any] = {
            "type": _TYPES.get(self.kind, f"urn:rbps:problem:{self.kind}"),
            "title": self.kind.replace("-", " "),
            "status": self.status,
            "detail": self.detail,
        }
        if self.kind in ADVICE:
            body["advice"] = ADVICE[self.kind]
        return body | ({"errors": self.errors} if self.errors else {})

    def response(self) -> JSONResponse:
        """The HTTP answer."""
        from starlette.responses import JSONResponse  # workers and the command line send none

        return JSONResponse(self.document(), self.status, self.headers, MEDIA_TYPE)


def unexpected(error: BaseException) -> str:
    """What is said of an error that is none of the engine's, and where it was raised."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}"
    return f"{type(error).__name__}: {error} ({where})"


def invalid(field: str, message: str, **more: Any) -> Problem:
    """422 about one field; ``more`` may hold row and channel."""
    error = {"field": field, "message": message} | more
    return Problem(422, "validation", f"{field}: {message}" if field else message, [error])
