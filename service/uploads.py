"""Series from uploaded files: CSV, .mat, .npz. Nothing is unpickled, nothing written to disk."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from engine.data.by_column import gather, in_order, parts_of
from engine.data.channels import check_order, check_units
from engine.data.files import TEXT, read_table, series_from
from engine.data.table import Table
from engine.diagnose.effects.setting import Setting
from engine.errors import SeriesError
from engine.statespace.model import MixedModel
from service.columns import match, noted
from service.file_names import as_asked, named
from service.problems import Problem, invalid
from service.schemas import LONGEST_NOTE, MOST_NOTES, Hold, ModelReference, Request, TimeUnit
from service.strict_json import loads
from service.validation import ADAPTER, find_model

BLANKS = re.compile(rb" +(?=[^\s])")  # between cells that nothing else parts
SMALL_BYTES = 1 << 22  # bytes that any file may hold
BY = '"by": "{}"'
ADVICE = ('"dt": STEP', '"t": "{}"', BY)  # members of an entry of ``series``


class _FileSeries(BaseModel):
    """One entry of ``series`` that is read from a file."""

    model_config = ConfigDict(extra="forbid", strict=True)
    file: str
    y: list[str] | dict[str, str] | None = None
    u: list[str] | dict[str, str] | None = None
    t: str | None = None
    dt: float | None = None
    hold: Hold | None = None  # None: as the file says
    time_unit: TimeUnit | None = None  # so here
    extra: list[str] = Field(default_factory=list, max_length=50)
    # what tells the records in one file apart
    by: Annotated[list[str], BeforeValidator(lambda x: [x] if isinstance(x, str) else x)] = Field(
        default_factory=list, max_length=10
    )

    @property
    def other(self) -> list[str]:
        """Columns that are neither channels of the model nor times."""
        return [*self.extra, *self.by]


def with_files(text: str, files: Mapping[str, bytes], max_values: int) -> Request:
    """A request whose series, or test, name uploaded files; without ``series``, each file is one.

    A file may hold ``max_values`` numbers at most.
    """
    for name, data in files.items():
        check_size(data, name, "file", max_values)
    try:
        body = loads(text)
    except (ValueError, RecursionError) as error:
        raise Problem(400, "not-json", f"request is not JSON: {error}") from None
    if not isinstance(body, dict):
        raise invalid("request", "is not a JSON object")
    if isinstance(body.get("model"), str):  # is told before its channels are looked for
        find_model(ModelReference(name=body["model"]), Setting)
    files = as_asked(files, body)
    _check_all_used(files, body)
    body.setdefault("data", list(files))
    notes: list[str] = []
    test = body.get("test")
    if isinstance(test, dict):
        test = [test]
    if isinstance(test, list):
        where = "test[{}]" if len(test) > 1 else "test"
        body["test"] = [one for _, one in _read_all(test, files, where, body, notes)]
        held_out = {one.get("file") for one in test if isinstance(one, dict)}
        files = {name: data for name, data in files.items() if name not in held_out}
    entries = body.get("series")
    if entries is None:
        entries = [{"file": name} for name in files]
    if isinstance(entries, list):
        read = _read_all(entries, files, "series[{}]", body, notes)
        body["series"] = [one for _, one in read]
        if body.get("kind") != "simulate":
            _check_apart(entries, read)
    if notes:
        body["notes"] = [one[:LONGEST_NOTE] for one in notes[:MOST_NOTES]]
    try:
        return ADAPTER.validate_python(body)
    except ValidationError as error:
        raise RequestValidationError(
            [item | {"loc": ("body", *item["loc"])} for item in error.errors()]
        ) from None


def _check_all_used(files: Mapping[str, bytes], body: Mapping[str, Any]) -> None:
    """Refuse files that would be left out without a word."""
    used = set(named(body))
    if not isinstance(body.get("series"), list) or not used <= set(files):
        return  # each file is a series; or a name is wrong, which is told where it is looked for
    for name in files:
        if name not in used:
            raise invalid("file", f"no series names '{name}': name it in series, or leave it out")


def _check_apart(entries: list[Any], read: list[tuple[int, Any]]) -> None:
    """Refuse what is read twice from one file: it would count as two experiments."""
    files = [one.get("file") if isinstance(one, dict) else None for one in entries]
    for n, (j, one) in enumerate(read):
        for k, other in read[:n]:
            file = files[j]
            if k != j and file is not None and files[k] == file and _same(other, one):
                raise invalid(
                    f"series[{j}].file", f"series[{k}] reads the same of '{file}': give each once"
                )


def _same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    pairs = ((one.get(member, ()), other.get(member, ())) for member in ("y", "u"))
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


def _read_all(
    entries: list[Any],
    files: Mapping[str, bytes],
    where: str,
    body: dict[str, Any],
    notes: list[str],
) -> list[tuple[int, Any]]:
    """The entries by their numbers; those that name a file are read from it, with ``notes`` of how.

    One whose columns tell records apart is as many.
    """
    out = list[tuple[int, Any]]()
    for i, one in enumerate(entries):
        named = isinstance(one, dict) and "file" in one
        each = _read(one, files, where.format(i), body, notes) if named else [one]
        out += [(i, part) for part in each]
    return out


def _read(
    entry: dict[str, Any],
    files: Mapping[str, bytes],
    where: str,
    body: dict[str, Any],
    notes: list[str],
) -> list[dict[str, Any]]:
    """{"file": ..., "y": columns, ...} -> {"y": table, "u": table, "t": times}, for each of its records."""
    try:
        wanted = _FileSeries.model_validate(entry)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(str(part) for part in first["loc"])
        raise invalid(f"{where}.{path}", first["msg"]) from None
    if wanted.file not in files:
        there = ", ".join(files) or "none"
        raise invalid(f"{where}.file", f"no file '{wanted.file}' was uploaded; there are {there}")
    model = _model(body.get("model"))
    try:
        table = read_table(files[wanted.file], wanted.file)
        if wanted.t:
            wanted.t = table.full(wanted.t)
        wanted.extra = [table.full(name) for name in wanted.extra]
        wanted.by = [table.full(name) for name in wanted.by]
        parts = _parts(table, wanted.by, f"{where}.by")
        y, u = (None, None) if model is None else _matched(table, wanted, model, where)
        how = wanted.t, wanted.dt, wanted.hold, wanted.time_unit, wanted.other, BY
        every = [series_from(part, y, u, *how) for part in parts]
        if wanted.by:
            gather(table, parts)
            table.notes.append(in_order(table, parts))
        if model is not None:
            check_units(every[0], model)
            clock = bool(wanted.t or wanted.dt), wanted.other
            channels = {**(y or {}), **(u or {})}
            told = noted(table, every[0], model, channels, clock, ADVICE, parts[0])
            notes += [f"{table.file}: {one}" for one in told]
    except SeriesError as error:
        raise invalid(f"{where}.file", str(error)) from None
    out = []
    for part, series in zip(parts, every, strict=True):
        read = {"y": series.y, "t": series.t.tolist(), "hold": series.hold}
        read["time_unit"] = series.time_unit
        if series.u.shape[1]:
            read["u"] = series.u
        if wanted.extra:
            read["extra"] = _extra(wanted, part, f"{where}.extra")
        out.append(read)
    return out


def _parts(table: Table, by: list[str], where: str) -> list[Table]:
    """The table, or its records."""
    try:
        return parts_of(table, by) if by else [table]
    except SeriesError as error:
        raise invalid(where, str(error)) from None


def _matched(
    table: Table, wanted: _FileSeries, model: MixedModel, where: str
) -> tuple[dict[str, str], dict[str, str]]:
    """{channel: column} of y and of u in the order of the model's channels."""
    outputs, inputs = list(model.outputs), list(model.inputs)
    given = _given(wanted.y, table, model, "y", f"{where}.y")
    given |= _given(wanted.u, table, model, "u", f"{where}.u")
    found = match(table, outputs, inputs, given, {*wanted.other, wanted.t or ""})
    for member, channels in (("y", outputs), ("u", inputs)):
        for channel in channels:
            if channel not in found and channel not in wanted.extra:
                series = {"file": wanted.file, member: {channel: "COLUMN"}}
                hint = f'"series": [{json.dumps(series)}]'
                raise invalid(
                    f"{where}.{member}",
                    f"no column is channel '{channel}'; say which it is with {hint}. There are "
                    f"{table.there()}",
                    channel=channel,
                )
    y, u = ({one: found[one] for one in some if one in found} for some in (outputs, inputs))
    return y, u


def _extra(wanted: _FileSeries, table: Table, where: str) -> dict[str, list[float]]:
    """Columns that the model does not use."""
    found = {}
    for name in wanted.extra:
        if name not in table.columns:
            raise invalid(where, f"there is no column '{name}'; there are {table.there()}")
        try:
            column = table.column(name)
        except SeriesError as error:
            raise invalid(where, str(error)) from None
        if (gaps := np.flatnonzero(~np.isfinite(column))).size:
            missing = table.with_lines(f"has no value at row {gaps[0]}")
            raise invalid(
                where,
                f"column '{name}' {missing}; an input must be known at every sample",
                row=int(gaps[0]),
                channel=name,
            )
        found[name] = column.tolist()
    return found


def _model(model: Any) -> MixedModel | None:
    """The request's model; None where something is wrong with it, which is told later."""
    try:
        reference = ModelReference.model_validate(
            {"name": model} if isinstance(model, str) else model
        )
        return find_model(reference, Setting)
    except (ValidationError, Problem):
        return None


def _given(
    columns: list[str] | dict[str, str] | None,
    table: Table,
    model: MixedModel,
    what: str,
    where: str,
) -> dict[str, str]:
    """{channel: column} of y or u as the request has it; in a list an array's name means all its columns."""
    channels = model.outputs if what == "y" else model.inputs
    there = f"the model's channels are {', '.join(channels) or 'none'}"
    if columns is None:
        return {}
    if isinstance(columns, dict):
        if unknown := sorted(set(columns) - set(channels)):
            raise invalid(where, f"names the channels {', '.join(unknown)}; {there}")
        return {channel: table.full(name) for channel, name in columns.items()}
    each = [c for name in columns for c in table.groups.get(name, [table.full(name)])]
    if len(each) != len(channels):
        raise invalid(where, f"names {len(each)} columns; {there}")
    try:
        check_order(tuple(each), channels, what, model)
    except SeriesError as error:
        raise invalid(where, str(error)) from None
    return dict(zip(channels, each, strict=True))


def check_size(data: bytes, filename: str, where: str, max_values: int) -> None:
    """Refuse a file of more numbers than a job may hold, before anything is made of them."""
    if Path(filename).suffix.lower() in TEXT:
        parted = sum(map(data.count, (b",", b";", b"\t"))) or sum(1 for _ in BLANKS.finditer(data))
        cells = parted + data.count(b"\n") + data.count(b"\r")
        if cells > max_values:
            raise invalid(where, f"'{filename}' has more than the {max_values} cells allowed here")
        return
    most = max(SMALL_BYTES, 8 * max_values)
    size = len(data)
    if data[:2] == b"PK":
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                size = sum(info.file_size for info in archive.infolist())
        except zipfile.BadZipFile:
            return  # the reader will say so
    elif data[:6] == b"MATLAB":
        size = _unpacked_mat(data, most)
    if size > most:
        raise invalid(where, f"'{filename}' unpacks to more than the {most} bytes allowed here")


def _unpacked_mat(data: bytes, most: int) -> int:
    """Size of the elements of a .mat file (version 5 to 7), unpacked, counted up to ``most``."""
    order, at, size = "<" if data[126:128] == b"IM" else ">", 128, 0
    while at + 8 <= len(data) and size <= most:
        kind, length = struct.unpack(order + "II", data[at : at + 8])
        if kind == 15:  # miCOMPRESSED
            stream, packed = zlib.decompressobj(), data[at + 8 : at + 8 + length]
            try:
                while packed and size <= most:
                    size += len(stream.decompress(packed, 1 << 20))
                    packed = stream.unconsumed_tail
            except zlib.error:
                return size  # the reader will say so
        else:
            size += length
        at += 8 + length
    return size
