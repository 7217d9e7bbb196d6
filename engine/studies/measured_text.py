"""What is known of the measured data sets, and what their diagnoses mean."""

from __future__ import annotations

KNOWN = {
    "nile": "the step of 1899, when the Aswan dam was begun (Cobb 1978; Harvey and Koopman 1992).",
    "tanks": "overflow of both tanks, readings that stop at 10 V, an offset of the level sensor "
    "(Schoukens, Mattsson, Wigren, Noel 2016).",
    "silverbox": "a cubic (hardening) spring, and a much smaller quadratic term (Wigren, Schoukens 2013).",
    "emps": "Coulomb friction of about 20 N and a constant force of about -3 N (Janot, Gautier, Brunot 2019).",
}

ANALYSIS = {
    "nile": """\
Right. Before, the random walk of the level stands in for the step, and so nothing shows in the
residuals; with the step its variance goes to zero, and the free run is better by the size of the
step. One step ahead hardly anything is gained on blocks left out of the fit: the random walk has
followed the step after a few years, and where the block of 1899 itself is left out, its year cannot
be known.""",
    "tanks": """\
The data checks see the reading stop at 10 V at once. The effects that are named are not the cause,
but they point to it: the process noise is said to depend on the pump's voltage, which is where the
tanks overflow, and no named effect explains more than an unnamed force on the same state does;
hence `unknown`. Overflow is a limit of a *state*, with the surplus going on into the lower tank;
the catalogue has saturations of a force, an input and a reading, but no such limit. The likelihood
of such a nearly noise-free record explains structural errors as process noise: sigma_y is at its
floor of 5 mV, and a gain in the one-step likelihood is worth nothing in simulation.""",
    "silverbox": """\
Not the cubic spring, and with a reason: the largest error of an *exact* discretisation with a held
input is that the true input is not held between the samples (nine samples per period of the
resonance). It comes out as what it is, at the input: a negative delay, which extrapolates the drive
by most of a sample, then a coupling of velocity into position that goes on repairing the same
thing, then a constant offset, which is real. The cubic spring is smaller than that in this stretch
(output 0.05 V, cubic stiffness 3.7 V^-2: 1 % of the spring's force) and stays behind it. The
free run says the same: most of its error goes with these, not with the spring. A discrete core
whose coefficients are free has no such error, and there the cubic is the largest effect. sigma_y is at
its floor of 0.2 mV.""",
    "emps": "",
}
