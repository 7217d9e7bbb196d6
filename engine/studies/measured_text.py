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
noise (sigma_y is at its floor of 5 mV), and what is gained so is worth nothing in simulation: the free
run of the extended model is worse on the test part, and its gain in density there is not significant.
The particle filter does not confirm the moment filter's gain either. (The row was made before such
an extension was refused; today it is not adopted.) Fitted by simulation error both models are alike,
0.67 V: nothing that simulates better was found.""",
    "silverbox": """\
A confident wrong name, for a reason. "Saturation of velocity" has a width of 0.4 1/s where velocities
are about 20 1/s: it is a *linear* term in velocity, and together with omega and zeta, which move far
away from their first estimates, it makes the coefficients of the linear core free. What it repairs is
the input: an exact discretisation with a held input is wrong by 20 mV here, since the true input is
not held between the samples (nine per period of the resonance). On a stretch of 1000 samples the same
error came out as a negative delay of the drive (extrapolating it by half a sample), then a coupling of
velocity into position, then an offset, with the verdict `unknown`. The cubic spring is smaller than all
that in this stretch (at 0.05 V, with 3.7 V^-2, 1 % of the spring's force) and stays behind it. A
catalogue with the input's course between the samples would name the first error; then the spring would
be next. Fitted by simulation error instead of likelihood both models do better: 25 and 15 mV as given, 10
and 6.5 mV extended. That difference is the symptom that something structural is wrong. sigma_y is at
its floor of 0.2 mV.""",
    "emps": """\
The right force under another name. A dead zone is a spring or damper that gives way at a width; here
the width is 0.09 mm/s and the slope -2300 1/s, so it is a force of -0.2 m/s^2 times the sign of the
velocity: Coulomb friction of 17 N with M = 86 kg (known: 20 N and 95 kg), and with it the viscous friction
falls from 417 to 201 N s/m (known: 203). `coulomb:velocity` itself was refitted and is 40 lower in 2 x
log-likelihood: sampled at 80 ms, a force that is switched by the sign chatters about standstill, and the
narrow dead zone rounds that off. Slope and width alone are not determined, only their product, as the
standard error says. The constant force is not seen because the model's load force, a random walk, has
taken it over; a free run has no such walk, and drifts by it. The other two effects repair the
standstills. One step ahead the extension gains much, in free run from likelihood estimates it is
worse, fitted by simulation error it halves the error (62 to 31 mm): the structure is right and the
likelihood's parameters do not simulate.""",
}
