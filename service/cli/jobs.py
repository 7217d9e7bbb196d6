"""``rbps jobs``: the jobs in the store of the service on this machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from engine import words
from service import strict_json
from service.cli.ending import wrong
from service.serializers import job_status
from service.settings import Settings
from service.store import SORTS, Store, Which


def show(
    text: str, tags: Sequence[str], kinds: Sequence[str], sort: str, most: int, as_json: bool
) -> None:
    """Print them, the newest first or sorted."""
    if sort.removeprefix("-") not in SORTS:
        raise wrong(f"--sort {sort}: choose one of {', '.join(SORTS)}, with a - for the other way")
    url = Settings.from_env().store_url
    file = url.removeprefix("sqlite:///")
    if file != url and not Path(file).is_file():
        raise wrong(f"there are no jobs here: {file} does not exist, 'rbps serve' makes it")
    store = Store(url)
    rows = store.jobs(most, None, Which(kind=kinds, tags=tags, text=text), sort)
    found = [job_status(row) for row in rows]
    store.close()
    if as_json:
        print(strict_json.dumps([one.model_dump() for one in found]))
        return
    for one in found:
        print(
            f"{one.jobID[:8]}  {one.created[:16].replace('T', ' ')}  {one.status}  {one.kind} {one.model}"
        )
        labels = ", ".join(filter(None, (one.name, *one.data, *(f"#{tag}" for tag in one.tags))))
        said = one.message if one.kind == "diagnose" else one.outcome or one.message
        values = ", ".join(f"{v.name} {words.estimate(v.value, v.standard_error, v.unit)}"
                           if v.standard_error else f"{v.name} {words.with_unit(v.value, v.unit)}"
                           for v in one.values)  # fmt: skip
        for line in (labels, said, values if one.kind != "diagnose" else ""):
            if line:
                print(f"          {line}")
    if not found:
        print("No job matches.")
