"""What the answers mean, and where they are not what is documented."""

from __future__ import annotations

LOOKED_AT: dict[str, str] = {
    "nile": """\
As documented. Before, the random walk of the level stands in for the step, and so nothing shows one step
ahead; with it the walk's variance goes to zero. The likelihood decides: the base's own noise makes free runs
as wrong as this one.""",
    "seatbelts": """\
As documented, size and row. Noise explains what the free run gets wrong, so the likelihood decides. On
blocks left out nothing is gained one step ahead, where the random walk has followed the step after a few
months.""",
    "emps": """\
As documented: both causes in one round, their sizes, and the test error of the reference. One step ahead a
noise of the reading that changes with the velocity wins; the free run overrules it. It is a `set` for two
reasons. Coulomb friction of the catalogue and the model's own Fc are the same law, discretised differently;
their runs differ by more than 5 % of what is left and so count as two. And a force on the square of the
velocity runs as well as the offset on a record that repeats one movement: only another one can part them.""",
    "silverbox": """\
As documented: the cubic spring, k3 / k1 = 4.0 V^-2, and an offset, which is the smaller second term. A constant
force and an offset of the input run alike, and are one answer. What is left, about 1.1 mV, is three times the
reference, which fits a free discrete core: between its samples the input is not quite a straight line either.
The second round sees a pattern in it (p = 0.09) but not at its level. Its null is too wide: the likelihood's
process noise alone would make free runs 4 times as wrong as this one is.""",
    "boucwen": """\
As documented: hysteresis, a state of its own, and with it the mass (2.00, truth 2 kg), whatever else is in the
set. Bouc-Wen's term delta is not in the catalogue; what stands for it are a cubic spring and functions of the
new state, and they are worth a factor 7 on both held-out records, without reaching the reference, which has
delta. A coupling of the new state is nearly the hysteresis once more, and the screen of the second round lists
the time step: one step a sample was chosen for the linear model, which is exact at any, and kept for the
extended one, which is not.""",
}
