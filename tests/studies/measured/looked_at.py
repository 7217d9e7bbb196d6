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
noise that depends on the position wins; the free run overrules it. It is a `set` for two reasons. Coulomb
friction of the catalogue and the model's own Fc are the same law, discretised differently; their runs differ by
more than 5 % of what is left and so count as two. And a force on the square of the velocity runs as well as the
offset on a record that repeats one movement: only another movement parts them, as the test record does.""",
}
