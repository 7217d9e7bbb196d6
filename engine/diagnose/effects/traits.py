"""What the search needs to know of a kind of effect beside its equation; the same for anybody's own."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

ANY = 100  # plainness of a kind that is plainer than none


class Course(Enum):
    """How an effect runs over time: it is then tried at every time or frequency of a grid.

    The effect's second parameter is the time of a ``STEP`` or ``PULSE``, of an ``EPISODE`` the time at which it
    begins and the third the one at which it is over; a ``HARMONIC`` has the amplitude of
    the sine and the frequency, a ``DRIFT`` the time where it is zero and the one to which its size refers,
    counted anew in each record, and a ``BEND`` how sharp it is, then the same two.
    """

    STEP = "step"
    PULSE = "pulse"
    EPISODE = "episode"
    HARMONIC = "harmonic"
    DRIFT = "drift"
    BEND = "bend"


@dataclass(frozen=True)
class Traits:
    """Traits of a kind.

    ``course`` over time, if it has one; ``of_parameter``: what runs is a parameter of the model, its channel;
    ``of_gain``: what runs is the gain of an input or an output.
    ``swallowed``: a fitted process noise can hide it from the screen, so that it is refitted all the same.
    ``unnamed``: it stands for whatever has no name. ``outliers``: judged by a filter that knows outliers.
    ``noise_level``: it changes the size of a channel's noise. ``plainness``: of effects that say the same,
    the one with the least is said. ``suits``: "rate" (friction), "position" (stiffness) or "store" (overflow:
    neither of these), where the kind is natural. ``says_hold``: what a series may say instead, see
    :class:`engine.Series`. ``contains``: plainer kinds that it becomes at the end of the range of its own
    parameters. ``of_record``: it says how the record that was searched begins, and nothing of another one.
    ``of_starts``: it says how far apart records begin, as their first readings alone tell.
    ``foreseen``: between which values its size is if it is the cause, where that is known before it is fitted.
    ``whole``: it is a delay whose size is the mean, and all of it, where it is there, is so late; its second
    parameter says how late its latest part is. ``bends``: it is looked for beside a drift that was found, which
    is straight, and both are one cause. ``odd``: as far as units tell, nothing does this at such a channel, so
    that any other effect is likelier beforehand.
    """

    course: Course | None = None
    of_parameter: bool = False
    of_gain: bool = False
    swallowed: bool = False
    unnamed: bool = False
    outliers: bool = False
    noise_level: bool = False
    plainness: int = ANY
    suits: str = ""
    says_hold: tuple[str, ...] = ()
    contains: tuple[str, ...] = ()
    of_record: bool = False
    of_starts: bool = False
    foreseen: tuple[float, float] | None = None
    whole: bool = False
    bends: bool = False
    odd: bool = False

    @property
    def alters(self) -> bool:
        """Whether what runs alters how the model answers, and adds nothing of its own."""
        return self.of_parameter or self.of_gain


USUAL = Traits()
