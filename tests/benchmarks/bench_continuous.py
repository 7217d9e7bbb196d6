"""A diagnosis of differential equations, beside an older commit.

    python -m tests.benchmarks.bench_continuous --against COMMIT [--model NAME] [--data FILE] [--samples N]

``tanks``: two water tanks in cascade by Bernoulli's law, written with :func:`engine.continuous`, on a record of
columns u_V and y_V every 4 s, or on one that is simulated with a rim that the upper tank runs over. ``room``: a
heated room, written with a matrix exponential for one time and one parameter vector a call. ``house``: two
zones, whose noise is a diagonal matrix of one parameter vector, with outliers. ``vessels``: two stirred
vessels, written with ``math.exp`` and a condition for one time and one parameter vector; the flow multiplies
the states.

The older commit is unpacked beside this one. Both run a pass of the filter, one with derivatives by all
parameters, and the whole diagnosis, of the first N samples if asked, in processes of their own, one after the
other; told are seconds of the processor. Writes ``results/continuous.md``, ``continuous-measured.md`` of a
file, ``continuous-NAME.md``.
"""

# ruff: noqa: E402 - the number of threads must be set before NumPy is loaded

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

import engine
from engine.compile_kernels import warm
from engine.diagnose import extend, hide
from engine.diagnose.effects.of_series import setting_for
from engine.estimation.quasi_ml import derivatives
from engine.filters.sigma_point import moment_filter

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parent / "results"
STEP = 4.0  # s
HELD = {"k1": 0.0833}
REPEATS = 5
SECONDS = " s in all: "  # in the line of a page that tells them
SAME = 1e-3  # of a number in the answer, or of the largest like it


def drift(a: Any, u: Any, t: Any, theta: Any) -> Any:
    root = np.sqrt(np.maximum(a, 0.0))
    upper = -theta.k1 * root[:, 0] + theta.k4 * u[0]
    return [upper, theta.k2 * root[:, 0] - theta.k3 * root[:, 1]], np.zeros((2, 0))


def initial(theta: Any) -> Any:
    return engine.Gaussian([5.0, 5.0], [[4.0, 0.0], [0.0, 1.0]]), [], np.zeros((0, 0))


def water_tanks() -> engine.MixedModel:
    """As the Guide says that models are written: the levels in volts of the sensor."""
    rate, noise = "V^0.5/s", "noise of the levels, per second"
    return engine.continuous(
        name="watertanks",
        drift=drift,
        diffusion=lambda a, u, t, theta: [[theta.q, 0.0], [0.0, theta.q]],
        measurement=lambda a, u, t, theta: ([a[:, 1]], np.zeros((1, 0)), [[theta.r]]),
        initial=initial,
        nonlinear={"upper": "V", "lower": "V"},
        inputs={"u": "V"},
        outputs={"y": "V"},
        parameters=[
            engine.Parameter("k1", 0.05, rate, (1e-3, 1.0), "outflow of the upper tank"),
            engine.Parameter("k2", 0.05, rate, (1e-3, 1.0), "inflow of the lower tank"),
            engine.Parameter("k3", 0.05, rate, (1e-3, 1.0), "outflow of the lower tank"),
            engine.Parameter("k4", 0.05, "1/s", (1e-3, 1.0), "pump"),
            engine.Parameter("q", 1e-4, "V^2/s", (1e-8, 1.0), noise),
            engine.Parameter("r", 1e-3, "V^2", (1e-6, 1.0), "variance of a reading"),
        ],
    )


def record(model: engine.MixedModel, file: str | None) -> engine.Series:
    if file is not None:
        table = np.genfromtxt(file, delimiter=",", names=True)
        return engine.Series(table["y_V"], table["u_V"], dt=STEP)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(1.0, 6.0, 30), 25)
    theta = {**HELD, "k2": 0.08, "k3": 0.08, "k4": 0.05, "overflow_upper": 0.2}
    theta["overflow_upper_limit"] = 9.0
    return hide(model, ["overflow:upper"], theta, len(u), rng, u=u, dt=STEP).series


AIR, WALL = 2e-3, 3e-4  # K per root second
QUARTER = 900.0  # s


def room_step(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> Any:
    """Van Loan (1978): two heat balances between samples, as a heating engineer would write them."""
    Ca, Cw, R1, R2, R3, q, _ = theta
    F = np.array([[-(1 / R1 + 1 / R2) / Ca, 1 / R1 / Ca], [1 / R1 / Cw, -(1 / R1 + 1 / R3) / Cw]])
    G = np.array([[1 / Ca, 1 / R2 / Ca], [0.0, 1 / R3 / Cw]])
    whole = expm(np.block([[F, G], [np.zeros((2, 4))]]) * dt)
    noise = np.diag([q**2, WALL**2])
    loan = expm(np.block([[-F, noise], [np.zeros((2, 2)), F.T]]) * dt)
    A = whole[:2, :2]
    return whole[:2, 2:] @ u, A, A @ loan[:2, 2:]


def heated_room() -> engine.MixedModel:
    """A room and its wall, in degrees Celsius."""
    return engine.MixedModel(
        name="heatedroom",
        dynamics=room_step,
        measurement=lambda a, u, t, theta: ([0.0], [[1.0, 0.0]], [[theta.r**2]]),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [19.0, 17.5], np.eye(2)),
        nonlinear={},
        linear={"air": "degC", "wall": "degC"},
        inputs={"heater": "W", "outdoor": "degC"},
        outputs={"thermometer": "degC"},
        parameters=[
            engine.Parameter("Ca", 4.6e5, "J/K", (1e4, 1e7)),
            engine.Parameter("Cw", 6e6, "J/K", (1e5, 1e8)),
            engine.Parameter("R1", 3.6e-3, "K/W", (1e-4, 1.0)),
            engine.Parameter("R2", 2.3e-2, "K/W", (1e-4, 1.0)),
            engine.Parameter("R3", 3e-2, "K/W", (1e-4, 1.0)),
            engine.Parameter("q", 1.2 * AIR, "K/s^0.5", (1e-6, 1.0)),
            engine.Parameter("r", 0.08, "K", (1e-5, 5.0)),
        ],
    )


def room_record(model: engine.MixedModel, file: str | None) -> engine.Series:
    rng = np.random.default_rng(1)
    heater = np.repeat(rng.choice([0.0, 700.0, 1500.0], 20), 20)
    outdoor = 6.0 - 4.0 * np.cos(2.0 * np.pi * QUARTER * np.arange(400) / 86400.0)
    u = np.column_stack([heater, outdoor])
    theta = {"Ca": 4e5, "R1": 4e-3, "R2": 2e-2, "q": AIR, "lag_thermometer": 0.5}
    return hide(model, ["lag:thermometer"], theta, 400, rng, u=u, dt=QUARTER).series


def house_drift(a: Any, u: Any, t: Any, theta: Any) -> Any:
    T = a[:, 0]
    f = [(theta.U1 * (u[1] - T) - theta.U * T + u[0]) / theta.C1, theta.U * T / theta.C2]
    return f, [[theta.U / theta.C1], [-theta.U / theta.C2]]


def house() -> engine.MixedModel:
    """Two zones in degrees Celsius and hours; its noise as most people write it."""
    return engine.continuous(
        name="house",
        drift=house_drift,
        diffusion=lambda a, u, t, theta: np.diag([theta.s1**2, theta.s2**2]),
        measurement=lambda a, u, t, theta: (
            [a[:, 0], 0.0],
            [[0.0], [1.0]],
            np.diag([theta.r**2, theta.r**2]),
        ),
        initial=lambda theta: (engine.Gaussian([20.0], [[4.0]]), [20.0], [[4.0]]),
        nonlinear={"T1": "degC"},
        linear={"T2": "degC"},
        inputs={"heat": "kW", "outdoor": "degC"},
        outputs={"zone1": "degC", "zone2": "degC"},
        parameters=[
            engine.Parameter("C1", 3.0, "kW h/K", (0.1, 50.0)),
            engine.Parameter("C2", 3.0, "kW h/K", (0.1, 50.0)),
            engine.Parameter("U1", 0.1, "kW/K", (0.0, 2.0)),
            engine.Parameter("U", 0.1, "kW/K", (0.0, 2.0)),
            engine.Parameter("s1", 0.1, "K/h^0.5", (1e-4, 2.0)),
            engine.Parameter("s2", 0.1, "K/h^0.5", (1e-4, 2.0)),
            engine.Parameter("r", 0.1, "K", (1e-3, 2.0)),
        ],
    )


def house_record(model: engine.MixedModel, file: str | None) -> engine.Series:
    rng = np.random.default_rng(1)
    heat = np.repeat(rng.choice([0.0, 2.0, 4.0], 40), 10)
    outdoor = 5.0 + 5.0 * np.sin(2.0 * np.pi * 0.25 * np.arange(400) / 24.0)
    theta = {"C1": 2.5, "C2": 4.0, "U": 0.15, "s1": 0.08, "s2": 0.05, "r": 0.08}
    theta |= {"heavy_tails_zone1_share": 0.05, "heavy_tails_zone1_ratio": 8.0}
    u = np.column_stack([heat, outdoor])
    return hide(model, ["heavy-tails:zone1"], theta, 400, rng, u=u, dt=0.25).series


def vessels_step(a: Any, u: Any, t: Any, dt: Any, theta: Any) -> Any:
    """Two salt balances over a step of held inputs, as a process engineer would write them."""
    fast, slow = u[0] / theta.V1, u[0] / theta.V2 + theta.k
    e1, e2 = math.exp(-fast * dt), math.exp(-slow * dt)
    if abs(fast - slow) > 1e-9:
        across = u[0] / theta.V2 * (e2 - e1) / (fast - slow)
    else:
        across = u[0] / theta.V2 * dt * e1
    A = np.array([[e1, 0.0], [across, e2]])
    rest = np.array([u[1], u[0] / theta.V2 / slow * u[1]])
    Q = np.zeros((2, 2))
    Q[0, 0] = Q[1, 1] = theta.q**2 * dt
    return rest - A @ rest, A, Q


def vessels() -> engine.MixedModel:
    """Concentrations in grams per litre."""
    return engine.MixedModel(
        name="vessels",
        dynamics=vessels_step,
        measurement=lambda a, u, t, theta: (
            [0.0, 0.0],
            np.eye(2),
            np.diag([theta.r**2, theta.r**2]),
        ),
        initial=lambda theta: (engine.Gaussian([], np.zeros((0, 0))), [35.0, 30.0], np.eye(2)),
        nonlinear={},
        linear={"first": "g/L", "second": "g/L"},
        inputs={"flow": "L/s", "feed": "g/L"},
        outputs={"probe1": "g/L", "probe2": "g/L"},
        parameters=[
            engine.Parameter("V1", 185.0, "L", (10.0, 1e4)),
            engine.Parameter("V2", 350.0, "L", (10.0, 1e4)),
            engine.Parameter("k", 1.2e-3, "1/s", (1e-6, 0.1)),
            engine.Parameter("q", 0.02, "g/L/s^0.5", (1e-5, 1.0)),
            engine.Parameter("r", 0.1, "g/L", (1e-4, 10.0)),
        ],
    )


def vessels_record(model: engine.MixedModel, file: str | None) -> engine.Series:
    rng = np.random.default_rng(1)
    flow = np.repeat(rng.uniform(1.0, 3.0, 40), 10)
    feed = np.repeat(rng.uniform(25.0, 45.0, 25), 16)
    theta = {"V1": 200.0, "V2": 320.0, "k": 1e-3, "lag_probe2": 0.6}
    u = np.column_stack([flow, feed])
    return hide(model, ["lag:probe2"], theta, 400, rng, u=u, dt=10.0).series


@dataclass(frozen=True)
class Case:
    """Whose record, a model, how it is made, what is held, the effects of single steps and of the diagnosis."""

    whose: str
    model: Callable[[], engine.MixedModel]
    record: Callable[[engine.MixedModel, str | None], engine.Series]
    held: dict[str, float]
    effects: tuple[str, ...]
    kinds: list[str]


CASES = {
    "tanks": Case(
        "two water tanks",
        water_tanks,
        record,
        HELD,
        ("overflow:upper", "bias:y", "lag:y", "input-saturation:u"),
        ["overflow", "saturation", "input-saturation", "bias", "lag"],
    ),
    "room": Case(
        "a heated room",
        heated_room,
        room_record,
        {"Cw": 6e6, "R3": 3e-2},
        ("coulomb:air->wall", "force:air", "lag:thermometer"),
        ["coulomb", "force", "lag", "bias", "delay"],
    ),
    "house": Case(
        "a house of two zones",
        house,
        house_record,
        {},
        ("force:T1", "lag:zone1", "heavy-tails:zone1"),
        ["heavy-tails", "force", "bias", "lag", "pulse"],
    ),
    "vessels": Case(
        "two stirred vessels",
        vessels,
        vessels_record,
        {},
        ("force:first", "lag:probe2", "delay:feed"),
        ["delay", "force", "lag", "bias", "step"],
    ),
}


def seconds(work: Callable[[], Any]) -> tuple[float, Any]:
    """Processor seconds, the least of some, and what came out."""
    work()
    taken = []
    for _ in range(REPEATS):
        started = time.process_time()
        out = work()
        taken.append(time.process_time() - started)
    return min(taken), out


def measured(case: Case, file: str | None, samples: int | None) -> dict[str, Any]:
    """What this process' engine takes, and what it answers."""
    warm()
    model, held = case.model(), case.held
    series = case.record(model, file)
    theta = np.asarray(model.theta(held))
    free = [name for name in model.parameter_names if name not in held]
    took: dict[str, float] = {}
    took["a pass of the moment filter"], _ = seconds(
        lambda: moment_filter(model, theta[None], series)
    )
    setting = setting_for(model, series, theta)
    for effects in ([], *([effect] for effect in case.effects)):
        one = extend(model, effects, setting) if effects else model
        at = np.asarray(one.theta(held))
        if effects:
            at[len(theta)] = 0.01 * (one.parameters[len(theta)].scale or 1.0)
        own = one.free_indices([p for p in one.parameter_names if p not in held])
        name = f"derivatives by {len(own)} parameters" + "".join(f", with {e}" for e in effects)
        took[name], _ = seconds(lambda one=one, at=at, own=own: derivatives(one, [series], at, own))
    part = series if samples is None else series.part(0, samples)
    engine.diagnose(model, part.part(0, 100), held, effects=["bias"], free=free)  # compiles
    # older commits know one process only
    alone = {"processes": 1} if "processes" in signature(engine.diagnose).parameters else {}
    started = time.process_time()
    found = engine.diagnose(model, part, held, effects=case.kinds, free=free, **alone)
    took[f"the diagnosis of {len(part)} samples"] = time.process_time() - started
    return {
        "seconds": took,
        "page": str(found),
        "answer": {**found.to_dict(), "seconds": {}, "page": ""},
    }


def leaves(document: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """All values of a JSON document with the places they stand at."""
    if isinstance(document, dict):
        for key, value in document.items():
            yield from leaves(value, f"{path}.{key}")
    elif isinstance(document, list):
        for value in document:  # numbers of one list are of one size
            yield from leaves(value, f"{path}[]")
    else:
        yield path, document


def _shared(document: Any, other: Any) -> Any:
    """A document without the keys that the other one has not."""
    if isinstance(document, dict) and isinstance(other, dict):
        return {k: _shared(v, other[k]) for k, v in document.items() if k in other}
    if isinstance(document, list) and isinstance(other, list):
        return [_shared(*pair) for pair in zip(document, other, strict=False)]
    return document


def agreement(one: Any, other: Any) -> tuple[int, int, list[str]]:
    """How many numbers both have, how many agree, and where words differ; keys of one alone are left out."""
    pairs = list(zip(leaves(_shared(one, other)), leaves(_shared(other, one)), strict=False))
    sizes: dict[str, float] = {}
    for (path, x), _ in pairs:
        if isinstance(x, float):
            sizes[path] = max(sizes.get(path, 0.0), abs(x))
    numbers = [(p, x, y) for (p, x), (_, y) in pairs if isinstance(x, float)]
    same = [isinstance(y, (int, float)) and abs(x - y) <= SAME * sizes[p] for p, x, y in numbers]
    words = [p for (p, x), (q, y) in pairs if not isinstance(x, float) and (p, x) != (q, y)]
    return len(numbers), sum(same), words


def of_commit(folder: Path, options: list[str]) -> dict[str, Any]:
    """:func:`measured` by the engine in a folder."""
    run = subprocess.run(
        [sys.executable, __file__, "--only", *options],
        env={**os.environ, "PYTHONPATH": str(folder)},
        cwd=folder,
        check=True,
        stdout=subprocess.PIPE,
    )
    return dict(json.loads(run.stdout))


def table(before: dict[str, Any], now: dict[str, Any], about: str) -> str:
    """The result file."""
    lines = [
        "# A diagnosis of differential equations, before and now",
        "",
        f"{about} Seconds of the processor, of repeated ones the least.",
        "",
        "| what | before | now | ratio |",
        "| --- | --- | --- | --- |",
    ]
    for name, took in now["seconds"].items():
        was = before["seconds"][name]
        lines.append(f"| {name} | {was:.3g} | {took:.3g} | {was / took:.1f} |")
    numbers, same, words = agreement(before["answer"], now["answer"])
    lines += [
        "",
        f"The answers: {same} of {numbers} numbers agree to {SAME:g} of their size"
        + (f"; {len(words)} words or their places differ." if words else "; all words do."),
        "",
        "Now:",
        "",
        *(f"    {line}".rstrip() for line in now["page"].splitlines()),
        "",
    ]
    pages = [one["page"].splitlines() for one in (before, now)]
    old, own = ([line for line in page if SECONDS not in line] for page in pages)
    if own != old:
        lines += ["Before:", "", *(f"    {line}".rstrip() for line in old), ""]
    return "\n".join(lines)


def main() -> None:
    """Measure, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", metavar="COMMIT")
    parser.add_argument("--model", choices=CASES, default="tanks")
    parser.add_argument("--data", metavar="FILE", help="CSV, of the tanks")
    parser.add_argument("--samples", metavar="N", type=int)
    parser.add_argument("--only", action="store_true", help="this engine's figures as JSON")
    asked = parser.parse_args()
    if not (asked.only or asked.against):
        parser.error("--against COMMIT is missing")
    file = None if asked.data is None else str(Path(asked.data).absolute())
    if asked.only:
        print(json.dumps(measured(CASES[asked.model], file, asked.samples)))
        return
    options = ["--model", asked.model, *(["--data", file] if file else [])]
    options += ["--samples", str(asked.samples)] if asked.samples else []
    from tests.benchmarks.machine import Watch

    with tempfile.TemporaryDirectory() as folder, Watch() as watch:
        archive = subprocess.run(
            ["git", "archive", asked.against], cwd=ROOT, check=True, stdout=subprocess.PIPE
        )
        subprocess.run(["tar", "x", "-C", folder], input=archive.stdout, check=True)
        before = of_commit(Path(folder), options)
        now = of_commit(ROOT, options)
    load = ", ".join(f"{name} {value:g}" for name, value in watch.figures().items())
    what = "A measured record" if file else "A simulated record"
    about = f"{what} of {CASES[asked.model].whose}; before: commit {asked.against}. {load}."
    which = f"-{asked.model}" if asked.model != "tanks" else "-measured" if file else ""
    name = f"continuous{which}.md"
    (RESULTS / name).write_text(table(before, now, about))


if __name__ == "__main__":
    main()
