"""The README's worked example with its pictures: ``python -m tests.benchmarks.worked_example``.

Runs the block of the README that hides an effect, prints the page and writes
``results/worked-example.txt`` and ``results/worked-example-*.png``.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
README = HERE.parents[1] / "README.md"
RESULTS = HERE / "results"
PICTURES = ("wrong", "candidates", "gain")


def block() -> str:
    """The block that hides an effect."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    return next(text for text in blocks if "hide(" in text)


def main() -> None:
    """Run it, keep what it says."""
    names: dict[str, Any] = {}
    exec(compile(block(), "README.md", "exec"), names)
    found = names["found"]
    (RESULTS / "worked-example.txt").write_text(str(found))
    figures = found.figures()
    for name in PICTURES:
        figures[name].savefig(
            RESULTS / f"worked-example-{name}.png", dpi=80, metadata={"Software": None}
        )


if __name__ == "__main__":
    main()
