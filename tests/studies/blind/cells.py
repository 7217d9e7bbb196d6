"""The cells of the benchmark: base model, hidden effect, number of rows, likelihood ratio."""

from __future__ import annotations

from dataclasses import dataclass

USUAL_ROWS, USUAL_RATIO = 1000, 40.0

# Chosen before any of the series that are judged was drawn: effects of every family whose screened
# footprint on clean series of the base has |cos| of at most 0.8 with that of any effect but wider kinds
# that contain it and other words for the same, so that at LR 40 some 14 are left between the truth and
# its nearest look-alike (a step in v1 has less where it is hidden: a ramp imitates it); and whose LR at
# one size differs little between series (what waits for a level that a random walk seldom visits has
# none in some series, and a hundred in others).
HIDDEN = {  # the first two of each base are hidden at other sizes and lengths too
    "linear-2": (
        "step:y",
        "variance:y->time",
        "parameter-step:theta",
        "heavy-tails:y",
        "pulse:y",
        "variance:a->time",
    ),
    "mixed-4": (
        "colored:y1",
        "quadratic:z2",
        "delay:y2",
        "step:z2",
        "harmonic:y2",
        "variance:y2->time",
    ),
    "servo": (
        "stribeck:velocity",
        "input-deadzone:drive",
        "variance:y->drive",
        "hysteresis:velocity",
        "quadratic:velocity",
        "pulse:velocity",
    ),
    "structure": (
        "coulomb:v1",
        "input-saturation:force",
        "parameter-drift:k1",
        "hysteresis:v1",
        "rectification:y2",
        "colored:y1",
    ),
}
# Effects with a look-alike of |cos| 0.93 or more in these experiments: a set is the right answer.
ALIKE = {
    "linear-2": ("level:y",),
    "mixed-4": ("bias:y1",),
    "servo": ("drag:velocity",),
    "structure": ("cubic:x1->v1", "drag:v1"),
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
HARD = [Cell(base, effect) for base, effects in ALIKE.items() for effect in effects]
# of every 24 clean series 12 are short and 4 long, as those take twenty times as long to diagnose
CLEAN_ROWS = (200, 200, 200, 1000, 1000, 4000)
CLEAN = [Cell(base, "", rows, 0.0) for rows in CLEAN_ROWS for base in HIDDEN]
UNLISTED = [Cell(base, f"outside:{kind}", ratio=100.0) for kind in OUTSIDE for base in HIDDEN]
# short records, as each of them is diagnosed a hundred times
BOOTSTRAP = [
    Cell("linear-2", "", 200, 0.0),
    Cell("linear-2", "step:y", 200),
    Cell("servo", "", 200, 0.0),
    Cell("servo", "stribeck:velocity", 200),
]
