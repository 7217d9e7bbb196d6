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
step. One step ahead hardly anything is gained on rows left out of the fit: the random walk has
followed the step after a few years, and where the block of 1899 itself is left out, its year cannot
be known.""",
    "tanks": """\
Not found, and said so. The data checks see the reading stop at 10 V at once. What is put into the
model is not the cause, but points to it: the process noise is said to depend on the pump's voltage,
and it is at high pump voltage that the tanks overflow. No named effect explains more than an unnamed
force on the same state does, hence `unknown`. Overflow is a limit of a *state*, with part of the
surplus going into the lower tank; the catalogue has saturations of a force, an input and a reading,
but no such limit. The likelihood of a nearly noise-free record explains structural errors as process
noise (sigma_y is at its floor of 5 mV), and what is gained so is worth nothing elsewhere: the extended
model is worse on the test part, one step ahead and in free run, and is not adopted. Fitted by simulation
error both models are alike, 0.67 V: nothing that simulates better was found.""",
    "silverbox": """\
`unknown`, with the largest error of the model found first and rightly named; it is not what the data set
is known for. More than two effects in turn are not trusted as names, and here something is left even
after the third. An exact discretisation with a held input is wrong by 20 mV here, since the true input
is not held between the samples (nine per period of the resonance): `hold:drive` says so. An offset of the
sensor and a correction of the linear core's damping follow (with omega and zeta it makes all of the
core's coefficients free). Together they take the free run from 25 to 4 mV on the test part, as good as
a fit by simulation error of the same model: likelihood and simulation agree, where they were 10 and
6.5 mV apart as long as the input's course between the samples was not in the catalogue. The cubic
spring is smaller than all that in this stretch (at 0.05 V, with 3.7 V^-2, 1 % of the spring's force);
the search ends after three effects, before its turn. sigma_y is at its floor of 0.2 mV.""",
    "emps": """\
The right force under another name. A dead zone is a spring or damper that gives way at a width; here
the width is far below any speed of the drive, and slope times width a force of constant size times the
sign of the velocity: Coulomb friction. Slope and width alone are not determined, only their product, as
the standard error says. `coulomb:velocity` itself was refitted and is behind in likelihood: sampled at
80 ms, a force that is switched by the sign chatters about standstill, and the narrow dead zone rounds
that off. The constant force is not seen because the model's load force, a random walk, has taken it
over; a free run has no such walk, and drifts by it. The other two effects, noises that change with
speed and drive, stand for what happens at the standstills, and something is left after them: `unknown`.
One step ahead the extension gains much; in free run it is worse, whether fitted by likelihood or by
simulation error: it should not have been adopted for a simulation.""",
}
