"""Machine code of older sources is thrown away.

Numba keeps the code of a kernel until its own file changes. What it has inlined of another file's kernels may
have changed by then, and the old code would go on being run without a word. So a digest of all sources lies
beside the code, and code of another digest goes.
"""

from __future__ import annotations

import hashlib
import warnings
from pathlib import Path

STAMP = "sources.sha256"


def discard_stale(sources: Path, cache: Path) -> bool:
    """Remove the code in ``cache`` unless it is of these ``sources``; whether there was other code.

    Warns where it cannot be removed.
    """
    files = sorted(sources.glob("*.py"))
    digest = hashlib.sha256(b"".join(f.name.encode() + f.read_bytes() for f in files)).hexdigest()
    stamp = cache / STAMP
    if stamp.is_file() and stamp.read_text() == digest:
        return False
    old = [*cache.glob("*.nbi"), *cache.glob("*.nbc")]
    try:
        for path in old:
            path.unlink(missing_ok=True)
        cache.mkdir(parents=True, exist_ok=True)
        stamp.write_text(digest)
    except OSError as error:
        if old:
            warnings.warn(
                f"kernels in '{cache}' are those of another version and cannot be removed ({error}): set "
                "NUMBA_CACHE_DIR to another folder",
                stacklevel=2,
            )
    return bool(old)
