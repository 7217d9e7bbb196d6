"""What can be asked of the list of jobs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, Field

from engine.words import enumerated
from service.responses import OUTCOMES, Kind, Status

Sort = Literal[
    "created", "name", "kind", "model", "data", "status", "outcome", "log_likelihood", "duration",
    "-created", "-name", "-kind", "-model", "-data", "-status", "-outcome", "-log_likelihood", "-duration",
]  # fmt: skip


def _known(outcome: str) -> str:
    if outcome not in OUTCOMES:
        raise ValueError(
            f"'{outcome[:40]}' is no outcome of a job; there are {enumerated(list(OUTCOMES))}"
        )
    return outcome


class ListQuery(BaseModel):
    """Which jobs to list, in which order."""

    status: list[Status] = Field(default=[])
    kind: list[Kind] = Field(default=[])
    outcome: list[
        Annotated[str, AfterValidator(_known), Field(json_schema_extra={"enum": [*OUTCOMES]})]
    ] = Field(default=[], description="verdict of a diagnosis, or how an estimation ended")
    tag: list[Annotated[str, Field(max_length=50)]] = Field(
        default=[], description="all of these tags"
    )
    model: str | None = Field(default=None, max_length=200, description="with its extensions")
    search: str = Field(
        default="", max_length=200, description="in name, tags, data, model or message"
    )
    sort: Sort = Field(default="-created", description="-: the largest first")
    limit: int = Field(default=50, ge=1, le=1000)
    cursor: int | None = Field(default=None, ge=1, le=2**31 - 1)
