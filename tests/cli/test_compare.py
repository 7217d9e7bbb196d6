"""Results with names, held-out errors, ``rbps compare`` and ``rbps jobs``."""

import json
import re

import numpy as np
import pytest

import engine
from engine.data.files import write_series


@pytest.fixture
def records(tmp_path):
    model = engine.get_model("oscillator")
    for name, seed in (("train", 0), ("test", 1)):
        u = np.repeat(np.random.default_rng(seed).uniform(-2, 2, 30), 10)
        rng = np.random.default_rng(10 + seed)
        write_series(
            engine.simulate(model, {"omega": 7.0}, 300, rng, u=u, dt=0.05).series,
            tmp_path / f"{name}.csv",
        )


def fit(rbps, out, *more):
    result = rbps(
        "fit", "train.csv", "-m", "oscillator", "--free", "omega,zeta", "--test", "test.csv",
        "--out", out, *more,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.slow
def test_two_results_side_by_side(rbps, records, tmp_path):
    said = fit(rbps, "a.json", "--method", "simulation", "--name", "by simulation", "--tag", "x,y")
    assert "on held-out data the simulation of y is wrong by" in said
    fit(
        rbps,
        "b.json",
        "--method",
        "rts-em",
        "-n",
        "20",
        "--name",
        "by likelihood",
        "--report",
        "b.html",
    )
    one, other = (json.loads((tmp_path / f"{name}.json").read_text()) for name in "ab")
    assert (one["name"], one["tags"], one["data"]) == ("by simulation", ["x", "y"], ["train.csv"])
    assert one["created"] <= other["created"]
    assert "by likelihood" in (tmp_path / "b.html").read_text()
    assert "On held-out data" in (tmp_path / "b.html").read_text()

    result = rbps("compare", "a.json", "b.json", "--report", "both.html")
    assert result.exit_code == 0, result.output
    lines = {line.split("  ")[0]: line for line in result.stdout.splitlines()}
    for name in ("omega", "zeta"):
        for document in (one, other):
            assert f"{document['estimate'][name]['value']:.5g}"[:5] in lines[name]
    assert re.search(r"standard errors\) +rad/s$", lines["omega"])
    assert "held" in lines["gain"]
    assert f"{one['held_out']['outputs'][0]['rmse']:.5g}"[:6] in lines["held-out error of y"]
    assert "<svg" in (tmp_path / "both.html").read_text()
    found = rbps("compare", "a.json", "b.json", "--json").json()
    assert found["names"] == ["by simulation", "by likelihood"]
    assert (found["same_data"], found["same_held_out"]) == (True, True)


def test_a_difference_of_log_likelihoods_has_the_errors_of_both(rbps, tmp_path):
    """Those of particle filters may be as large as what is gained."""
    seen = {"t": [0.0, 1.0, 2.0], "measured": {"y": [1.0, 2.0, 4.0]}, "y": {"y": [1.0, 2.0, 3.0]}}
    for name, value, error in (("a", 1788.4, 3.0), ("b", 1817.07, 4.0)):
        document = {
            "estimate": {"q": {"value": 1.0, "unit": ""}},
            "log_likelihood": {"value": value, "standard_error": error},
            "examination": {"series": [{"free_run": {"curves": seen}}]},
            "held_out": {"samples": 3, "log_density": value / 10.0, "outputs": []},
        }
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    result = rbps("compare", "a.json", "b.json")
    assert result.exit_code == 0, result.output
    assert re.search(r"log-likelihood +1788.4 \+- 3 +1817.07 \+- 4 +28.67 \+- 5\n", result.stdout)
    assert re.search(r"held-out log-density +178.84 +181.707", result.stdout)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "no estimate, diagnosis, simulation or state"),
        ("[1]", "not a result written with --out"),
        ("nonsense", "not a result written with --out"),
    ],
)
def test_files_that_are_no_results(rbps, tmp_path, text, words):
    (tmp_path / "a.json").write_text(text)
    result = rbps("compare", "a.json", "a.json")
    assert result.exit_code == 2
    assert words in result.stderr


def test_the_jobs_of_the_service_here(rbps, tmp_path, monkeypatch):
    from service.settings import Settings
    from service.store import Store

    monkeypatch.setenv("RBPS_STATE_DIR", str(tmp_path / "state"))
    nothing = rbps("jobs")
    assert nothing.exit_code == 2
    assert "there are no jobs here" in nothing.stderr
    store = Store(Settings.from_env().store_url)
    for name in ("zeta", "alpha"):
        store.create("estimate", "tanks", {"name": name, "tags": ["pump"], "data": ["may.csv"]}, 1)
        result = {
            "outcome": "converged",
            "estimate": {"k": {"value": 2.0, "standard_error": 0.1, "unit": "1/s"}},
        }
        store.finish(store.claim("w"), result)
    store.create("simulate", "servo", {}, 1)
    store.close()
    said = rbps("jobs", "--tag", "pump", "--sort", "name").stdout
    assert said.index("alpha") < said.index("zeta")
    assert "k 2 +- 0.1 1/s" in said
    assert "may.csv, #pump" in said
    assert "servo" not in said
    assert [one["model"] for one in rbps("jobs", "--kind", "simulate", "--json").json()] == [
        "servo"
    ]
    assert "No job matches" in rbps("jobs", "nonsense").stdout
    assert rbps("jobs", "--sort", "nonsense").exit_code == 2


@pytest.mark.slow
def test_a_unit_of_time(rbps, tmp_path):
    """Read from the column's name, or given: it is printed, and changes no number."""
    from engine.data import nile

    flows = nile()
    rows = [f"{t:.0f},{y:g}" for t, y in zip(flows.t, flows.y[:, 0], strict=True)]
    (tmp_path / "flows.csv").write_text("\n".join(["year,flow", *rows]))
    ask = ("diagnose", "flows.csv", "-m", "local-level", "--time", "year", "--effects", "step")
    by_year = rbps(*ask)
    assert by_year.exit_code == 0, by_year.output
    assert "every 1 year" in by_year.stderr
    assert "time 1899 year" in by_year.stdout
    by_day = rbps(*ask, "--time-unit", "day")
    assert "time 1899 day" in by_day.stdout
    cut = slice(None, by_year.stdout.index("Notes"))
    assert by_day.stdout[cut.start : by_day.stdout.index("Notes")].replace(
        "day", "year"
    ).split() == (by_year.stdout[cut].split())
    assert "time_unit" in rbps("fit", "flows.csv", "-m", "local-level", "--time", "year",
                               "--method", "simulation", "--json").stdout  # fmt: skip
