"""The cells of the benchmark: base model, hidden effect, number of rows, likelihood ratio."""

from __future__ import annotations

from dataclasses import dataclass

USUAL_ROWS, USUAL_RATIO = 1000, 40.0

HIDDEN = {  # the first two of each base are hidden at other sizes and lengths too
    "linear-2": (
        "step:y",
        "colored:y",
        "variance:y->time",
        "parameter-step:theta",
        "level:y",
        "heavy-tails:y",
    ),
    "mixed-4": (
        "bias:y1",
        "cubic-sensor:y2",
        "drift:y2",
        "harmonic:y1",
        "coupling:a->z2",
        "heavy-tails:y2",
    ),
    "servo": (
        "drag:velocity",
        "delay:drive",
        "stribeck:velocity",
        "step:velocity",
        "input-deadzone:drive",
        "pulse:velocity",
    ),
    "structure": (
        "cubic:x1->v1",
        "coulomb:v1",
        "drag:v1",
        "parameter-step:k1",
        "gain:y2",
        "saturation-sensor:y1",
    ),
}
OUTSIDE = ("chirp", "telegraph", "play")


@dataclass(frozen=True)
class Cell:
    """One cell; ``effect`` is "" for clean data, ``ratio`` the LR of the true extension, 0 where none."""

    base: str
    effect: str
    rows: int = USUAL_ROWS
    ratio: float = USUAL_RATIO

    @property
    def name(self) -> str:
        """Text that identifies it."""
        return f"{self.base} {self.effect or 'clean'} N={self.rows} LR={self.ratio:g}"


USUAL = [Cell(base, effect) for base, effects in HIDDEN.items() for effect in effects]
OTHER = [
    cell
    for base, effects in HIDDEN.items()
    for effect in effects[:2]
    for cell in (
        Cell(base, effect, ratio=15.0),
        Cell(base, effect, ratio=100.0),
        Cell(base, effect, rows=200),
        Cell(base, effect, rows=4000),
    )
]
CLEAN = [Cell(base, "", rows, 0.0) for rows in (200, 1000, 4000) for base in HIDDEN]
UNLISTED = [Cell(base, f"outside:{kind}", ratio=100.0) for kind in OUTSIDE for base in HIDDEN]
# short records, as each of them is diagnosed a hundred times
BOOTSTRAP = [
    Cell("linear-2", "", 200, 0.0),
    Cell("linear-2", "step:y", 200),
    Cell("servo", "", 200, 0.0),
    Cell("servo", "drag:velocity", 200),
]
