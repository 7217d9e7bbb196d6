"""A function written for one time and one parameter vector, evaluated for many: recorded once, then replayed.

``math.exp(-theta.k * dt)``, ``np.array([[1.0, dt], [-theta.k, 1.0]])``, ``if u[0] > theta.limit``: physics is
written so, and takes no rows. What such a function calculates can be written down while it runs once on numbers
that remember where they come from (:mod:`.numbers`, :mod:`.arrays`), as programs for automatic
differentiation do ("operator overloading": A. Griewank, A. Walther, Evaluating Derivatives, 2nd ed. 2008,
ch. 6). The list of operations is then gone through for all rows at once (:mod:`.program`). Conditions are
part of the list: rows for which one turns out otherwise are recorded by themselves. Where a whole number
becomes a length or a key, which number it is counts as such a condition.

What cannot be written down (a number that becomes a text) is refused, and the function is called row by row.
So is a function that reads what it left at its last call (:mod:`.left_behind`). Each way
through a function is compared with a call of it for the row on which it was recorded, and all are tested as any
call of many rows is, by :mod:`engine.statespace.evaluation`.

What filters call at every time step is recorded with the effects around it, and is a tape for a kernel
(:mod:`engine.statespace.tape`).

While it is recorded a function finds other functions under its global names (:mod:`.stand_ins`), where those of
NumPy and of Python take plain numbers only (:mod:`.of_numpy`, :mod:`.of_python`).
"""

from engine.statespace.recorded.paths import NotByRowsError
from engine.statespace.recorded.program import Recorded, by_rows

__all__ = ["NotByRowsError", "Recorded", "by_rows"]
