"""The Guide's worked example of a designed experiment: ``python -m tests.benchmarks.designed_example``.

Runs the block of the Guide's page that hides an effect, writes what it prints to
``results/designed-example.txt`` and its pictures to ``results/designed-example-*.png``.
"""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "service" / "guide" / "pages" / "design.md"
RESULTS = HERE / "results"


def block() -> str:
    """The block that hides an effect."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return next(text for text in blocks if "hide(" in text)


def main() -> None:
    """Run it, keep what it says."""
    names: dict[str, Any] = {}
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(block(), "design.md", "exec"), names)
    (RESULTS / "designed-example.txt").write_text(said.getvalue())
    for name, figure in names["design"].plot().items():
        figure.savefig(
            RESULTS / f"designed-example-{name}.png", dpi=80, metadata={"Software": None}
        )


if __name__ == "__main__":
    main()
