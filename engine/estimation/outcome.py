"""How an estimation ended, as sentences a person can act on."""

from __future__ import annotations

from enum import Enum


class Outcome(Enum):
    """How an estimation ended; ``value`` says it in a sentence, ``success`` whether theta is an estimate."""

    CONVERGED = "Converged: the last iterates show no trend beyond their Monte Carlo noise."
    UNDECIDED = "Settled, but perhaps short of the maximum: the particles scatter too much to tell."
    ITERATIONS_USED_UP = "Iterations used up before the iterates settled: allow more of them."
    STALLED = (
        "Standing still short of the maximum: with so little noise the steps of EM are too small to be seen, "
        "while the likelihood still rises. Use method='quasi-newton', or start closer."
    )
    STOPPED_BY_CALLER = "Stopped by the caller before the iterates settled."
    DIVERGED = (
        "Diverged: the filter or the parameters are no longer finite. Start closer, tighten the "
        "parameters' bounds, or check the model's units."
    )
    COLLAPSED = (
        "Lost: at these parameters the particle filter collapses onto single particles, so the "
        "iterates follow noise. Check the units of the data, or use more particles, another start, or a "
        "larger measurement noise."
    )
    WANDERED = (
        "Wandered off: the iterates ended where parameters are far less likely than others they have "
        "passed, by the moment filter and by the particle filter; the likeliest of those are kept. The "
        "particles are too few to follow this series: use more of them, or hold a larger process noise."
    )

    @property
    def word(self) -> str:
        """How documents and pages write it."""
        return self.name.lower().replace("_", "-")

    @property
    def success(self) -> bool:
        """False where theta must not be taken for an estimate."""
        return self not in (Outcome.DIVERGED, Outcome.COLLAPSED)
