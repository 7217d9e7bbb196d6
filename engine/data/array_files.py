"""Arrays of .npz and .mat files to columns. Nothing is ever unpickled."""

from __future__ import annotations

import io
import math
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np

from engine.data.table import Table
from engine.errors import SeriesError

LARGEST_BYTES = 4 << 30  # an .npz may unpack to, and memory for reading a .mat
MAT_TO_NPZ = Path(__file__).with_name("mat_to_npz.py")  # a program of its own


def read_npz(data: bytes, file: str) -> Table:
    """Arrays y, u, t, dt (or others by name) of an .npz archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > LARGEST_BYTES:
                raise SeriesError(
                    f"{file} unpacks to {size} bytes; at most {LARGEST_BYTES} are read"
                )
            for info in archive.infolist():
                _check_array(archive, info)
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            found = {}
            for name in stored.files:
                try:
                    found[name] = stored[name]
                except ValueError:  # an object array: it would have to be unpickled
                    found[name] = None
    except SeriesError:
        raise
    except Exception as error:
        raise SeriesError(f"{file} is not a readable .npz archive: {error}") from error
    return _from_arrays(found, file)


def _check_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> None:
    """Raise ValueError for an array whose header claims more than there is; room would be made for it."""
    with archive.open(info) as stream:
        if stream.read(6) != b"\x93NUMPY":
            return
        stream.seek(0)
        version = np.lib.format.read_magic(stream)
        readers = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        # (3, 0) is for tables with named fields, which are not used here
        if version not in readers:
            return
        shape, _, dtype = readers[version](stream)
        there = info.file_size - stream.tell()
    needed = math.prod(shape) * dtype.itemsize
    if needed > there and not dtype.hasobject:
        raise ValueError(f"the array '{info.filename}' claims {needed} bytes and has fewer")


def read_mat(data: bytes, file: str) -> Table:
    """Arrays y, u, t, dt (or others by name) of a MATLAB file, version 4 to 7."""
    if data[:4] == b"\x89HDF" or data[512:516] == b"\x89HDF" or data[:10] == b"MATLAB 7.3":
        raise SeriesError(f"{file} is a MATLAB 7.3 file; save it with -v7: save('{file}', '-v7')")
    program = [sys.executable, "-P", str(MAT_TO_NPZ), str(LARGEST_BYTES >> 20)]
    read = subprocess.run(program, input=data, capture_output=True, check=False)
    if read.returncode:
        complaint = read.stderr.decode(errors="replace").strip().splitlines()
        reason = complaint[-1] if complaint and read.returncode > 0 else "its reader crashed on it"
        raise SeriesError(f"{file} is not a readable MATLAB file: {reason}")
    return _from_arrays(dict(np.load(io.BytesIO(read.stdout), allow_pickle=False)), file)


def _from_arrays(found: dict[str, object], file: str) -> Table:
    """A table of the numeric arrays: one column per channel of a (T, n) array."""
    table = Table(file, {}, {})
    for name, value in found.items():
        if name.endswith("_names"):
            continue
        told = name.lower()
        text = _stored_text(value) if told in ("hold", "time_unit") else None
        if text is not None:
            setattr(table, told, text)
            continue
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.ndim > 2:
            table.ignored.append(f"'{name}' is not a table of real numbers")
            continue
        array = np.asarray(value, dtype=float)
        if array.size == 1 and name.lower() in ("dt", "ts"):
            table.dt = float(array.ravel()[0])
            continue
        if array.ndim < 2 or array.shape[0] == 1:  # vectors, MATLAB's rows among them
            array = array.reshape(-1, 1)
        n = array.shape[1]
        names = _stored_names(found.get(f"{name}_names"))
        if len(names) != n:
            names = [f"{name}{i + 1}" for i in range(n)] if n > 1 else [name]
        table.groups[name] = names
        for i, column in enumerate(names):
            table.columns[column] = np.ascontiguousarray(array[:, i])
            table.groups.setdefault(column, [column])
    return table


def _stored_text(value: object) -> str | None:
    """A text as an array holds it; None for other arrays."""
    if not isinstance(value, np.ndarray) or value.dtype.kind != "U":
        return None
    return str(value.ravel()[0]) if value.size else ""


def _stored_names(value: object) -> list[str]:
    """Channel names stored beside an array."""
    return list(map(str, value.ravel())) if isinstance(value, np.ndarray) else []
