"""What is documented of each record: what its simple model leaves out, and how well others simulate it.

Figures are from the README.md that comes with each record's data, which cites them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

BASELINES = "Champneys, Beintema, Toth, Schoukens, Rogers 2024 (arXiv 2405.10779), read from their result files"


@dataclass(frozen=True)
class Known:
    """``missing`` in words; ``start`` the model that was diagnosed, with units, and how.

    ``published`` are results of others, ``reference`` errors (base, extended) on each test part, by least
    squares on the free run, with the first 50 rows not scored, where the README has them.
    """

    missing: str
    start: str
    published: str
    reference: Mapping[str, tuple[float, float]] = field(default_factory=dict)


KNOWN = {
    "nile": Known(
        "a step down in 1899, when the first Aswan dam was being built: about -248 x 1e8 m^3.",
        "A random walk observed with noise (`local-level`).",
        "change point 1898/99 (Cobb 1978); variances 15099 and 1469 (Durbin, Koopman).",
    ),
    "seatbelts": Known(
        "a step of -0.238 in the log at the law of 31 January 1983, row 169.",
        "A random walk, 11 seasonal dummies and the log of the petrol price; y is the log of the number of "
        "drivers killed or seriously injured. The column that tells the law is hidden.",
        "-0.238 (Harvey, Durbin 1986; Durbin, Koopman 2001).",
    ),
    "emps": Known(
        "a constant force of about -3.3 N and Coulomb friction of about 21 N.",
        "M v' = gtau u - Fv v - d, q' = v, y = q + e (`servo` with Fc and offset held at 0; free are M, Fv and "
        "the noises; d is its load force, a random walk). u in V, y in m. Readings are thinned, and u averaged "
        "over the time between them.",
        f"black boxes on the test record: LSTM 74, RNN 89, OLSTM 111, FIR-MLP 121, GRU 220 mm ({BASELINES}).",
        {"pulses": (101.8, 5.05)},
    ),
    "silverbox": Known(
        "a cubic, hardening spring, k3 / k1 about 3.7 V^-2; a much smaller quadratic term and an offset.",
        "x'' = -omega^2 x - 2 zeta omega x' + gain omega^2 u, y = x + e (`oscillator`), u and y in V; u goes "
        "straight from sample to sample (hold = foh), as the excitation is limited in band.",
        f"GRU 1.49 / 2.80 / 0.95, LSTM 1.50 / 2.68 / 0.96, FIR-MLP 18.9 / 20.2 / 15.3 mV ({BASELINES}); "
        "polynomial nonlinear state space 0.26 mV on the arrow (Paduart et al. 2010).",
        {
            "multisine": (6.96, 0.389),
            "arrow": (14.41, 0.563),
            "arrow, no extrapolation": (6.58, 0.383),
        },
    ),
    "boucwen": Known(
        "a hysteretic force with a state of its own (Bouc-Wen). The record is simulated, and its truth known: "
        "z' = alpha v - beta (gamma |v| z + delta v |z|), alpha 5e4 N/m, beta 1e3, gamma 0.8, delta -1.1.",
        "m x'' = F - c x' - k x, y = x + e (`spring`), F in N, y in m; F goes straight from sample to sample.",
        "PNLSS 0.012 to 0.019 mm, dynoNet 0.045 mm (Esfahani et al. 2017; Noel et al. 2017; Forgione, Piga "
        "2021).",
        {"multisine": (0.179, 0.0063), "sweep": (0.153, 0.0030)},
    ),
    "battery": Known(
        "a voltage that relaxes for minutes after a step of the current: one pair of R and C, R1 2.4 mOhm, "
        "tau 109 s; a second one hardly pays.",
        "q' = I / Q, V = ocv(q) + R0 I + e (`cell`), ocv a table of 15 knots whose values are parameters, "
        "Q held at 32 Ah; I in A is the mean since the row before (hold = past). Odd pulses and all that "
        "is between pulses are fitted, even pulses judge, all in one run.",
        "none with this split; in the README's fit to all rows 13.4 mV, with one pair 6.2 mV.",
    ),
    "tanks": Known(
        "overflow of the tanks, part of it from the upper into the lower one; an offset of the level; readings "
        "that stop at 10 V; an outflow that is not exactly a square root.",
        "x1' = -k1 sqrt(x1) + k4 u + d, x2' = k1 sqrt(x1) - k3 sqrt(x2), y = x2 + e (`tanks`; d is an inflow "
        "nobody measures, a slow random walk). u and y in V.",
        f"polynomial NARX 0.413, GRU 0.396, LSTM 0.490 V ({BASELINES}); NLSS2 0.343, PNLSS-I 0.450 V (Relan et "
        "al. 2017); grey box with overflow about 0.19 V (Rogers et al. 2017).",
        {"test": (0.686, 0.356)},
    ),
}
