"""What can be asked of the list of jobs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from service.responses import Kind, Status

Sort = Literal[
    "created", "name", "kind", "model", "data", "status", "outcome", "log_likelihood", "duration",
    "-created", "-name", "-kind", "-model", "-data", "-status", "-outcome", "-log_likelihood", "-duration",
]  # fmt: skip


class ListQuery(BaseModel):
    """Which jobs to list, in which order."""

    status: list[Status] = Field(default=[])
    kind: list[Kind] = Field(default=[])
    outcome: list[Annotated[str, Field(max_length=40)]] = Field(
        default=[], description="such as named, set, unknown, nothing; converged"
    )
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
