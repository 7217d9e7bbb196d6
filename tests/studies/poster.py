"""Poster: PS-EM on a scalar linear system beside exact EM, and on a nonlinear one.

The poster has lost its equations and figures. Ours: ``scalar-linear``, for which exact EM exists, and
the growth model of Schon, Wills, Ninness (2011), with the cost surface and the iterates on it.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from engine.estimation.ps_em import ps_em
from engine.filters.rbpf import rbpf
from tests.studies.em_arms import PAPER, em_arm
from tests.studies.plots import axes, save
from tests.studies.problems import PROBLEMS, model_named
from tests.studies.realisation import LIKELIHOOD, METHOD, realisation, stream
from tests.studies.report import made_with, markdown, plain
from tests.studies.statistics import mean, root_mean, spread
from tests.studies.study import Arm, Row, Study, Tables

RUNS = 25
RUNS_MANY = 10  # with MANY particles instead of 50
MANY = 400
OURS = {**PAPER["ps"], "n_iterations": 100, "m_step": "bfgs"}
PS_LINEAR = em_arm("poster-linear", "ps-em", "ps", OURS)
MANY_LINEAR = em_arm("poster-linear", f"ps-em-{MANY}", "ps", {**OURS, "n_particles": MANY})
EXACT_LINEAR = em_arm("poster-linear", "rts-em", "rts", {"tolerance": None, "n_iterations": 100})
PS_GROWTH = em_arm("poster-nonlinear", "ps-em", "ps", {**OURS, "n_particles": 100})


def report_linear(tables: Tables) -> str:
    """Estimates, and how far PS-EM is from exact EM on the same data."""
    ours, exact = tables[PS_LINEAR.name], tables[EXACT_LINEAR.name]
    many = tables[MANY_LINEAR.name]
    model = model_named("scalar-linear")
    lines, bias = [], []
    for name in PROBLEMS["poster-linear"].free:
        a, b = ours.numbers(f"last.{name}"), exact.numbers(f"last.{name}")
        c = many.numbers(f"last.{name}")
        n, m = min(len(a), len(b)), min(len(a), len(b), len(c))
        truth = model.parameters[model.parameter_names.index(name)].default
        lines.append(
            [
                name,
                f"{truth:g}",
                " ± ".join((plain(mean(b), 4)[0], plain(spread(b), 4)[0])),
                " ± ".join((plain(mean(a), 4)[0], plain(spread(a), 4)[0])),
                " ± ".join(plain(mean(a[:n] - b[:n]), 4)),
                plain(root_mean((a[:n] - b[:n]) ** 2), 4)[0],
            ]
        )
        differences = (a[:m] - b[:m], c[:m] - b[:m])
        bias.append([name, *(" ± ".join(plain(mean(d), 4)) for d in differences)])
    head = [
        "parameter",
        "true",
        "exact EM, mean ± std. dev.",
        "PS-EM, mean ± std. dev.",
        "PS-EM minus exact, mean ± s.e.",
        "root mean square",
    ]
    text = [
        "x' = a x + v, y = x + e, v ~ N(0, q), e ~ N(0, r): 200 samples, 100 iterations, "
        "50 particles, starts drawn within a factor of 2. The poster's own figures are lost.\n",
        markdown(head, lines),
        f"The bias of PS-EM is that of its number of particles. PS-EM minus exact EM on the first {m} "
        "realisations, mean ± s.e.:\n",
        markdown(["parameter", "50 particles", f"{MANY} particles"], bias),
        made_with(tables),
    ]
    return "\n".join(text)


def plot_linear(tables: Tables, path: Path) -> None:
    """Iterates of both methods, first ten runs."""
    free = PROBLEMS["poster-linear"].free
    figure, panels = axes(1, len(free), (10.5, 3.4))
    for panel, name in zip(panels, free, strict=True):
        for table, style in ((EXACT_LINEAR.name, "k-"), (PS_LINEAR.name, "C0-")):
            curves = tables[table].curves(f"trace.{name}")[:10].T
            label = "exact EM" if style == "k-" else "PS-EM"
            lines = panel.plot(np.linspace(0, 100, len(curves)), curves, style, linewidth=0.7)
            lines[0].set_label(label)
        panel.set_title(name)
        panel.set_xlabel("iteration")
    panels[0].legend(frameon=False)
    save(figure, path)


POSTER_LINEAR = Study(
    "poster-linear",
    "Poster: PS-EM beside exact EM on a scalar linear system",
    {PS_LINEAR: RUNS, MANY_LINEAR: RUNS_MANY, EXACT_LINEAR: RUNS},
    report_linear,
    plot_linear,
)

GRID_A = np.linspace(0.0, 1.0, 31)
GRID_B = np.linspace(5.0, 45.0, 31)
SURFACE_PARTICLES = 300


def surface_row(seed: int, run: int) -> Row:
    """Log-likelihood along b at the ``run``-th value of a, the other parameters being true."""
    started = time.perf_counter()
    model = model_named("growth")
    series = realisation(model, seed, 0).series
    values = []
    for b in GRID_B:
        rng = np.random.default_rng(stream(seed, 0, LIKELIHOOD))
        theta = {"a": float(GRID_A[run]), "b": float(b)}
        filtered = rbpf(model, theta, series, SURFACE_PARTICLES, rng)
        values.append(filtered.log_likelihood)
    return {
        "a": float(GRID_A[run]),
        "log_likelihood": " ".join(f"{v:.6g}" for v in values),
        "seconds": time.perf_counter() - started,
    }


def surface_iterates(seed: int, run: int) -> Row:
    """PS-EM in a and b only on the data of the surface, from its own start."""
    started = time.perf_counter()
    model = model_named("growth")
    series = realisation(model, seed, 0).series
    rng = np.random.default_rng(stream(seed, run, METHOD))
    theta0 = {"a": rng.uniform(0.0, 1.0), "b": rng.uniform(5.0, 45.0)}
    options = {**OURS, "n_particles": 100, "n_iterations": 50}
    with np.errstate(all="ignore"):
        result = ps_em(model, series, theta0, ["a", "b"], seed=run, **options)
    a, b = (result.trace[:, model.parameter_names.index(name)] for name in ("a", "b"))
    return {
        "trace.a": " ".join(f"{v:.5g}" for v in a),
        "trace.b": " ".join(f"{v:.5g}" for v in b),
        "seconds": time.perf_counter() - started,
    }


SURFACE = Arm("poster-nonlinear.surface", surface_row, {"particles": SURFACE_PARTICLES})
ITERATES = Arm("poster-nonlinear.iterates", surface_iterates, {"n_iterations": 50})


def report_growth(tables: Tables) -> str:
    """Estimates of all six parameters."""
    table = tables["poster-nonlinear.ps-em"]
    model = model_named("growth")
    lines = []
    for name in PROBLEMS["poster-nonlinear"].free:
        values = table.numbers(f"last.{name}")
        truth = model.parameters[model.parameter_names.index(name)].default
        start = table.numbers(f"start.{name}")
        lines.append(
            [
                name,
                f"{truth:g}",
                f"{start.min():.3g} - {start.max():.3g}",
                f"{np.median(values):.4g}",
                *(plain(mean(values), 4)[:1]),
                *(plain(spread(values), 4)[:1]),
            ]
        )
    head = ["parameter", "true", "starts", "median", "mean", "std. dev."]
    text = [
        "x' = a x + b x / (1 + x^2) + c cos(1.2 t) + v, y = d x^2 + e (Schon, Wills, Ninness 2011; "
        "the poster's own equations are lost): all six parameters by PS-EM with 100 particles, "
        f"100 iterations, 200 samples, {len(table)} realisations. The plot shows the cost (minus "
        "log-likelihood, by particle filters with common random numbers) over a and b with the "
        "iterates of PS-EM in these two.\n",
        markdown(head, lines),
        made_with(tables),
    ]
    return "\n".join(text)


def plot_growth(tables: Tables, path: Path) -> None:
    """The cost surface with iterates drawn on it."""
    rows = tables["poster-nonlinear.surface"]
    cost = -rows.curves("log_likelihood")
    figure, (panel,) = axes(1, 1, (6.4, 4.8))
    above = np.log10(cost - np.nanmin(cost) + 1.0)
    drawn = panel.contourf(GRID_B, GRID_A[: len(above)], above, 24, cmap="viridis")
    figure.colorbar(drawn, label="log10(cost - minimum + 1)")
    iterates = tables["poster-nonlinear.iterates"]
    for a, b in zip(iterates.curves("trace.a"), iterates.curves("trace.b"), strict=True):
        panel.plot(b, a, "w.-", linewidth=0.7, markersize=3)
        panel.plot(b[0], a[0], "wo", markersize=5)
    panel.plot(25.0, 0.5, "r+", markersize=14, markeredgewidth=2)
    panel.set_xlim(GRID_B[0], GRID_B[-1])
    panel.set_ylim(GRID_A[0], GRID_A[-1])
    panel.set_xlabel("b")
    panel.set_ylabel("a")
    save(figure, path)


POSTER_NONLINEAR = Study(
    "poster-nonlinear",
    "Poster: PS-EM on a nonlinear system, cost surface and iterates",
    {PS_GROWTH: RUNS, SURFACE: len(GRID_A), ITERATES: 8},
    report_growth,
    plot_growth,
)
