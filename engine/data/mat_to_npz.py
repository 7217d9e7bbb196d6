"""A MATLAB file on standard input, its arrays as .npz on standard output; run as a program of its own.

SciPy's reader is compiled code that a damaged file can crash: it then takes this process with it and
nobody else's. Nothing of ``engine`` is imported, which would take longer than the reading.
"""

from __future__ import annotations

import io
import sys

import numpy as np
from scipy.io import loadmat

PROCESSOR_SECONDS = 60  # in which any file that can be uploaded is read


def limit(megabytes: int) -> None:
    """Memory and processor time of this process, where the system has such limits."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    for what, most in (
        (resource.RLIMIT_AS, megabytes << 20),
        (resource.RLIMIT_CPU, PROCESSOR_SECONDS),
    ):
        hard = resource.getrlimit(what)[1]
        resource.setrlimit(what, (most if hard < 0 else min(most, hard), hard))


def flat(name: str, value: object) -> np.ndarray:
    """What .npz holds without pickling; a text in place of what is no table of real numbers."""
    array = np.asarray(value)
    if array.dtype.kind in "fiub":
        return array
    if name.endswith("_names") or name.lower() in ("hold", "time_unit"):
        cells = array.ravel().tolist()
        return np.array([str(np.ravel(cell)[0]) if np.size(cell) else "" for cell in cells])
    return np.array("")


if __name__ == "__main__":
    limit(int(sys.argv[1]))
    try:
        found = loadmat(io.BytesIO(sys.stdin.buffer.read()))  # type: ignore[arg-type]  # stubs know paths only
        tables = {name: flat(name, v) for name, v in found.items() if not name.startswith("__")}
    except Exception as error:  # noqa: BLE001  # whatever it is, it is said
        sys.exit(str(error) or type(error).__name__)
    out = io.BytesIO()
    np.savez(out, allow_pickle=False, **tables)
    sys.stdout.buffer.write(out.getvalue())
