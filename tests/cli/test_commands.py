"""What each command does, in this process."""

import csv
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from urllib.request import urlopen

import numpy as np
import pytest

import engine
from engine import words
from engine.data.files import read_series, write_series
from service import stages
from service.computations import simulate as simulated_by_the_service
from service.examples import EXAMPLES
from service.strict_json import dumps
from service.validation import load
from tests.cli.conftest import RBPS
from tests.engine.clear_step import clear_flows
from tests.patience import eventually

QUICK = ("-n", "3", "--no-standard-errors")

MINE = """
import numpy as np
import engine

def dynamics(a, u, t, dt, theta):
    return [theta.c * a[:, 0] + u[0]], np.zeros((1, 0)), [[0.01]]

def measurement(a, u, t, theta):
    return [a[:, 0]], np.zeros((1, 0)), [[0.01]]

def initial(theta):
    return engine.Gaussian([0.0], [[0.1]]), [], np.zeros((0, 0))

mine = engine.MixedModel(
    name="mine", dynamics=dynamics, measurement=measurement, initial=initial,
    nonlinear={"x": ""}, inputs={"push": "N"}, outputs={"reading": "m"},
    parameters=[engine.Parameter("c", 0.5, "", (-1, 1))])
"""


@pytest.fixture
def flows(tmp_path):
    path = tmp_path / "flows.csv"
    path.write_text("year,flow\n" + "".join(
        f"{1871 + i},{value:g}\n" for i, value in enumerate(clear_flows().y[:, 0])))  # fmt: skip
    return path


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(MINE)
    return path


# ---- help -------------------------------------------------------------------------------------


def test_help_names_commands_and_exit_codes(rbps):
    shown = rbps("--help")
    assert shown.exit_code == 0
    for word in ("models", "fit", "diagnose", "simulate", "serve", "130 interrupted"):
        assert word in shown.stdout
    for command in ("models", "fit", "diagnose", "simulate", "serve"):
        assert "Exit codes: 0 done; 1" in " ".join(rbps(command, "--help").stdout.split())


@pytest.mark.long
def test_the_first_try_that_help_shows_works(rbps, tmp_path):
    shown = re.sub(r"\\\n", " ", rbps("--help").stdout)
    commands = [
        shlex.split(line)[1:] for line in re.findall(r"^ +(rbps \w.*)", shown, re.MULTILINE)
    ]
    quicker = {
        "simulate": ["-n", "100"],
        "fit": ["-n", "2", "--particles", "10"],
        "diagnose": ["--effects", "coulomb,bias"],
    }
    assert [command[0] for command in commands] == list(quicker)
    for command in commands:
        result = rbps(*command, *quicker[command[0]])
        assert result.exit_code == 0, result.output
    assert "oscillator" in (tmp_path / "run.html").read_text()


def test_help_does_not_wait_for_the_engine():
    code = (
        "import sys; sys.argv = ['rbps', 'fit', '--help']\n"
        "from service.cli.commands import main\n"
        "try: main()\n"
        "finally: print('numba' in sys.modules, 'engine' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "False False"


def test_version(rbps):
    assert rbps("--version").stdout.startswith("rbps 0.")


# ---- models -----------------------------------------------------------------------------------


def test_models_are_listed(rbps):
    listed = rbps("models")
    assert listed.exit_code == 0
    assert "local-level" in listed.stdout
    assert {model["name"] for model in rbps("models", "--json").json()} == set(engine.model_names())


def test_one_model(rbps):
    shown = rbps("models", "servo").stdout
    for word in ("M v' = gtau u", "velocity", "drive", "[0, 1e+06]", "N s/m", "viscous friction"):
        assert word in shown
    document = rbps("models", "servo", "--json").json()
    assert document["parameters"][1] == {
        "name": "Fv", "unit": "N s/m", "default": 203.0, "bounds": [0.0, 1e6],
        "description": "viscous friction",
    }  # fmt: skip
    extended = rbps("models", "servo", "--with", "coulomb:velocity", "--json").json()
    assert extended["parameters"][-1]["name"] == "coulomb_velocity"
    effects = rbps("models", "servo", "--effects").stdout
    assert "coulomb:velocity" in effects
    listed = rbps("models", "servo", "--effects", "--json").json()
    assert {"coulomb:velocity", "bias:y"} <= {one["name"] for one in listed}


def test_a_model_of_a_users_file(rbps, mine):
    for reference in ("mine.py:mine", "mine.py"):
        assert rbps("models", reference, "--json").json()["inputs"] == {"push": "N"}


@pytest.mark.long
def test_a_model_of_a_users_package(tmp_path):
    (tmp_path / "shop.py").write_text(MINE)
    info = tmp_path / "shop-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shop\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[engine.models]\nmine = shop:mine\nbad = shop:none\n")
    run = subprocess.run([*RBPS, "models"], env=os.environ | {"PYTHONPATH": str(tmp_path)},
                         capture_output=True, text=True, check=True)  # fmt: skip
    assert any(line.split() == ["mine"] for line in run.stdout.splitlines())
    assert "the plug-in 'bad' could not be loaded" in run.stderr


# ---- fit --------------------------------------------------------------------------------------


@pytest.mark.long
def test_fit_gives_the_engines_numbers(rbps, flows):
    result = rbps("fit", flows, "-m", "local-level", "--set", "q=5000", "--free", "q,r", "--seed", 3,
                  "--fix", "level=1100", *QUICK, "--json")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    (line,) = result.stderr.splitlines()
    assert "a step of 1 s is assumed" in line
    document = result.json()
    model = engine.get_model("local-level")
    found = engine.rbps_em(model, clear_flows(), {"q": 5000.0, "level": 1100.0}, free=["q", "r"],
                           n_iterations=3, seed=3)  # fmt: skip
    for name in ("q", "r"):
        assert document["estimate"][name]["value"] == found.theta[name]
        assert document["trace"]["theta"][name] == found.trace[:, model.index(name)].tolist()
    assert document["estimate"]["level"]["fixed"]
    assert document["outcome"] == "iterations-used-up"


class InMemory:
    """What the service's tasks tell and leave, without a store."""

    def __init__(self):
        self.results = []

    def rows(self):
        return np.zeros((0, 0))

    def estimated(self, document):
        pass

    def start(self, theta):
        pass

    def iteration(self, it):
        pass

    def step(self, k, message="", share=None):
        pass

    def left(self, task):
        return json.loads(dumps(self.results[task]))


def test_one_run_is_no_bootstrap(rbps, flows):
    result = rbps("fit", flows, "-m", "local-level", "--bootstrap", 1)
    assert (result.exit_code, "--bootstrap 1: one run shows no spread" in result.stderr) == (
        2,
        True,
    )


@pytest.mark.slow
def test_starts_and_bootstrap_are_the_services(rbps, flows):
    result = rbps("fit", flows, "-m", "local-level", "--set", "q=3000", "--free", "q,r", "--method",
                  "rts-em", "-n", 5, "--starts", 3, "--bootstrap", 4, "--seed", 2, "-o", "a.json")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    job = load({
        "kind": "estimate", "model": "local-level", "series": [{"y": clear_flows().y.tolist()}],
        "parameters": {"start": {"q": 3000.0}, "free": ["q", "r"]},
        "options": {"method": "rts-em", "iterations": 5, "starts": 3, "bootstrap": 4, "seed": 2},
    })  # fmt: skip
    there = InMemory()
    for task in range(3 + 1 + 4 + 1):
        there.results.append(stages.run(job, task, there))
    mine, theirs = (json.loads(text) for text in (
        flows.with_name("a.json").read_text(), dumps(there.results[-1])))  # fmt: skip
    for document in (mine, theirs):
        del document["trace"]["seconds"]
    labels = {name: mine.pop(name) for name in ("name", "tags", "data", "created", "notes")}
    assert labels["data"] == ["flows.csv"]
    assert "a step of 1 s is assumed" in labels["notes"][0]  # of the file, which a request has not
    assert mine == theirs
    assert "from 4 estimations on data simulated at the estimate" in result.stdout
    found = [line for line in result.stdout.splitlines() if line.startswith("start ")]
    reached = [float(line.split()[3].rstrip(";")) for line in found]
    assert len(reached) == 3
    assert reached == sorted(reached, reverse=True)
    low, high = mine["estimate"]["q"]["interval"]
    assert f"{words.number(low, 4)} to {words.number(high, 4)}" in result.stdout
    assert not list(flows.parent.rglob("*.state"))


@pytest.mark.slow
def test_fit_writes_what_is_asked_for(rbps, flows, tmp_path):
    result = rbps("fit", flows, "-m", "local-level", "--method", "rts-em", "-n", "300",
                  "--out", "out.json", "--report", "out.html", "--plot", "figures")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert "Converged" in result.stdout
    assert "Written: out.json" in result.stdout
    document = json.loads((tmp_path / "out.json").read_text())
    assert document["estimate"]["q"]["standard_error"] > 0
    page = (tmp_path / "out.html").read_text()
    assert page.startswith("<!doctype html>")
    assert "local-level" in page
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {
        f"{name}.{ending}"
        for name in ("convergence", "states", "free-run")
        for ending in ("svg", "png")
    }
    assert not list(tmp_path.rglob("*.state"))  # converged: nothing to go on with
    assert not list(tmp_path.glob(".*"))


@pytest.mark.long
def test_more_iterations_after_they_were_used_up(rbps, flows, tmp_path):
    exact = ("-m", "local-level", "--method", "rts-em", "--set", "q=50")
    options = (flows, *exact, "--no-standard-errors", "--json")
    whole = rbps("fit", *options, "-n", "4").json()
    (tmp_path / ".rbps" / "flows.state").unlink()
    assert rbps("fit", *options, "-n", "2", "-o", "two.json").exit_code == 0
    more = rbps("fit", "--resume", ".rbps/two.state", "-n", "4", "--json").json()
    assert more["trace"]["theta"] == whole["trace"]["theta"]
    assert more["log_likelihood"] == whole["log_likelihood"]
    assert (
        json.loads((tmp_path / "two.json").read_text())["trace"]["theta"]
        == (whole["trace"]["theta"])
    )
    less = rbps("fit", "--resume", ".rbps/two.state", "-n", "1")
    assert less.exit_code == 2
    assert "--iterations 1: 4 are done already" in less.stderr


@pytest.mark.long
def test_an_earlier_state_is_kept(rbps, flows, tmp_path):
    for seed in (1, 2):
        assert rbps("fit", flows, "-m", "local-level", "--seed", seed, *QUICK).exit_code == 0
    assert (tmp_path / ".rbps" / "flows.state").exists()
    assert (tmp_path / ".rbps" / "flows.state~").exists()


@pytest.mark.long
def test_several_files_and_columns_by_name(rbps, mine, tmp_path):
    rng = np.random.default_rng(0)
    model_series = []
    for i in range(2):
        table, x = rng.standard_normal((20, 2)), 0.0
        for row in table:  # of the model, with less noise
            row[1], x = x + 0.1 * row[1], 0.5 * x + row[0]
        with (tmp_path / f"run{i}.csv").open("w", newline="") as stream:
            csv.writer(stream).writerows([["Time", "force", "gauge"],
                                          *([k, *row] for k, row in enumerate(table))])  # fmt: skip
        model_series.append(engine.Series(table[:, 1], table[:, 0]))
    result = rbps("fit", "run0.csv", "run1.csv", "-m", "mine.py:mine", "--map", "reading=gauge",
                  "--map", "push=force", *QUICK, "--json")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    from service.cli.references import model_of

    found = engine.rbps_em(model_of("mine.py:mine"), model_series, n_iterations=3)
    assert result.json()["estimate"]["c"]["value"] == found.theta["c"]
    assert len(result.json()["states"]["series"]) == 2


def test_fit_with_an_effect(rbps, flows):
    result = rbps("fit", flows, "-m", "local-level", "--with", "step:flow", "--free", "step_flow",
                  "--set", "step_flow_time=50", *QUICK, "--json")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert result.json()["estimate"]["step_flow"]["value"] != 0.0


@pytest.mark.long
def test_plain_lines_tell_what_was_read(rbps, flows):
    lines = rbps("fit", flows, "-m", "local-level", *QUICK).stderr.splitlines()
    assert lines[0] == "rbps: flows.csv: 100 samples every 1 s; flow"
    assert lines[1].startswith(
        "rbps: flows.csv: no column of times: a step of 1 s is assumed; else --dt STEP"
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("column", "times", "why"),
    [
        ("when", [k**1.5 for k in range(9)], "rises like times"),
        ("year", range(1871, 1880), "counts up evenly"),
    ],
)
def test_a_step_that_is_assumed_is_said_whatever_is_quiet(rbps, tmp_path, column, times, why):
    (tmp_path / "a.csv").write_text(
        f"{column},flow\n" + "".join(f"{one},{k % 4}\n" for k, one in enumerate(times))
    )
    result = rbps(
        "fit", tmp_path / "a.csv", "-m", "local-level", *QUICK, "--json", "-q", "-o", "o.json"
    )
    assert result.exit_code == 0, result.stderr
    said = "a.csv: no column of times: a step of 1 s is assumed; else --dt STEP, or, as "
    said += f"'{column}' {why}, --time '{column}'."
    assert result.stderr.splitlines() == [f"rbps: {said}"]
    assert result.json()["notes"] == [said]
    assert json.loads((tmp_path / "o.json").read_text())["notes"] == [said]
    other = rbps("fit", tmp_path / "a.csv", "-m", "local-level", *QUICK, "-q", "--time", column)
    assert (other.exit_code, other.stderr) == (0, "")


# ---- diagnose ---------------------------------------------------------------------------------

FEW = ("--effects", "step,pulse", "--seed", "1")


@pytest.mark.long
def test_diagnose(rbps, flows, tmp_path):
    result = rbps("diagnose", flows, "-m", "local-level", *FEW, "--report", "out.html",
                  "-o", "out.json", "--plot", "figures")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert "NAMED" in result.stdout
    assert "step:flow" in result.stdout
    assert "step:flow" in (tmp_path / "out.html").read_text()
    assert (tmp_path / "figures" / "wrong.svg").exists()
    document = json.loads((tmp_path / "out.json").read_text())["diagnosis"]
    assert document["extension"]["model"]["with"] == ["step:flow"]
    assert document["extension"]["model"]["name"] == "local-level"


@pytest.mark.slow
def test_diagnose_lists_what_is_asked_about_first_and_all_on_demand(rbps, flows):
    kinds = "step,pulse,ramp,harmonic,drift,gain,cubic,drag,coulomb,deadzone,lag,heavy-tails,level"
    result = rbps("diagnose", flows, "-m", "local-level", "--effects", kinds, "--all",
                  "-o", "out.json")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    found = json.loads(flows.with_name("out.json").read_text())["diagnosis"]
    there = [one["effect"] for one in found["detectable"] if one["testable"]]
    short = found["page"].partition("could have shown")[2].partition("Not testable")[0]
    listed = [name for name in there if f"  {name} " in short]
    assert len(listed) == 12 < len(there)
    assert f"and {len(there) - 12} more: 'rbps diagnose --all'" in short
    every = result.stdout.partition("could have shown")[2]
    assert [name for name in there if f"  {name} " not in every] == []


@pytest.mark.slow
def test_diagnose_for_machines(rbps, flows):
    result = rbps("diagnose", flows, "-m", "local-level", *FEW, "--json", "--exit-code")
    assert result.exit_code == 3
    (line,) = result.stderr.splitlines()
    assert "a step of 1 s is assumed" in line
    assert result.json()["diagnosis"]["verdict"] == "named"
    # the step is in the model now, and nothing else is left
    again = rbps("diagnose", flows, "-m", "local-level", "--with", "step:flow", "--set",
                 "step_flow_time=28", "--set", "step_flow=-250", *FEW, "--exit-code")  # fmt: skip
    assert again.exit_code == 0, again.stderr
    assert "NOTHING" in again.stdout


@pytest.mark.long
def test_diagnose_asks_about_extra_columns(rbps, tmp_path):
    rng = np.random.default_rng(0)
    own, rain, read = rng.standard_normal((3, 80))
    level = 1100 + np.cumsum(np.append(0.0, 20 * own + 60 * rain)[:-1])  # the rain of before
    with (tmp_path / "run.csv").open("w", newline="") as stream:
        table = zip(level + 30 * read, rain, strict=True)
        csv.writer(stream).writerows([["flow", "rain"], *table])
    result = rbps("diagnose", "run.csv", "-m", "local-level", "--extra", "rain", "--effects",
                  "extra-input,bias", "--json")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    (cause,) = result.json()["diagnosis"]["causes"]
    assert "rain" in cause["effect"]


@pytest.mark.long
def test_diagnose_holds_what_is_fixed(rbps, flows):
    result = rbps("diagnose", flows, "-m", "local-level", "--fix", "q=0", *FEW, "--json")
    assert result.json()["diagnosis"]["base_theta"]["q"] == 0.0


# ---- simulate ---------------------------------------------------------------------------------


def test_simulate_is_the_services_simulation(rbps):
    request = EXAMPLES["simulate"]["value"]
    result = rbps("simulate", "-m", request["model"], "--set", "theta=0.2", "-n",
                  request["options"]["samples"], "--seed", request["options"]["seed"], "--json")  # fmt: skip

    class Quiet:
        def step(self, k, message="", share=None):
            pass

    job = load(request)
    assert result.json() == simulated_by_the_service(job, job.request, Quiet())


def test_simulate_hides_an_effect(rbps, tmp_path):
    result = rbps("simulate", "-m", "servo", "--with", "coulomb:velocity=0.2", "--set", "Fc=0",
                  "--excite", "drive=steps:2:0.5", "-n", "100", "--dt", "0.01", "--seed", "4",
                  "-o", "run.csv")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    written = read_series(tmp_path / "run.csv")
    model = engine.get_model("servo", ["coulomb:velocity"])
    expected = engine.simulate(model, {"Fc": 0.0, "coulomb_velocity": 0.2}, 100,
                               np.random.default_rng(4), u=written.u, dt=0.01)  # fmt: skip
    assert np.array_equal(written.y, expected.y)
    levels = written.u[:, 0].reshape(2, 50)
    assert (levels == levels[:, :1]).all()  # held for half a second each
    assert np.abs(levels).max() <= 2.0
    assert levels[0, 0] != levels[1, 0]


def test_simulate_takes_the_times_that_a_file_has_and_says_which(rbps, tmp_path):
    """As a fit does: whatever the first column of the file is, a column of dates among them."""
    (tmp_path / "two.csv").write_text("time,t,pump\n10,0,2\n20,1,3\n30,2,2\n")
    (tmp_path / "dates.csv").write_text("day,t,pump\nMon,0,2\nTue,4,3\nWed,8,2\n")
    two = rbps("simulate", "-m", "tanks", "--inputs", "two.csv", "-o", "run.csv")
    assert "times are those of column 'time', not of 't'" in two.stderr
    assert read_series(tmp_path / "run.csv").t.tolist() == [10.0, 20.0, 30.0]
    dates = rbps("simulate", "-m", "tanks", "--inputs", "dates.csv", "-o", "run.csv")
    assert dates.exit_code == 0, dates.stderr
    assert read_series(tmp_path / "run.csv").t.tolist() == [0.0, 4.0, 8.0]


def test_simulate_heeds_how_inputs_are_held(rbps, tmp_path):
    u = np.sin(np.arange(30.0))
    given = engine.Series(np.zeros(30), u, dt=0.1, u_names=["drive"], hold="foh")
    write_series(given, tmp_path / "in.csv")
    result = rbps("simulate", "-m", "servo", "--inputs", "in.csv", "--seed", 4, "-o", "run.csv")
    assert result.exit_code == 0, result.stderr
    rng = np.random.default_rng(4)
    expected = engine.simulate(engine.get_model("servo"), None, 30, rng, u=u, dt=0.1, hold="foh")
    written = read_series(tmp_path / "run.csv")
    assert written.hold == "foh"
    assert np.allclose(written.y, expected.y)


def test_simulate_inputs_of_a_file_and_csv_on_stdout(rbps, tmp_path):
    u = np.sin(np.arange(30.0))
    write_series(engine.Series(np.zeros(30), u, dt=0.1, u_names=["drive"]), tmp_path / "in.csv")
    result = rbps("simulate", "-m", "servo", "--inputs", "in.csv", "--no-noise")
    rows = list(csv.DictReader(result.stdout.splitlines()))
    model = engine.get_model("servo")
    run = engine.free_run(model, None, engine.Series(np.full(30, np.nan), u, dt=0.1))
    assert np.allclose([float(row["y"]) for row in rows], run.y[:, 0])
    assert [float(row["u_drive"]) for row in rows] == u.tolist()


@pytest.mark.parametrize(("kind", "value"), [("sine", 2.0 * np.sin(0.4 * np.pi)), ("square", 2.0)])
def test_simulate_periodic_inputs(rbps, kind, value):
    result = rbps("simulate", "-m", "servo", "--excite", f"drive={kind}:2:5", "-n", "4")
    rows = list(csv.DictReader(result.stdout.splitlines()))
    assert float(rows[1]["u_drive"]) == pytest.approx(value)


@pytest.mark.long
def test_what_is_simulated_can_be_fitted(rbps):
    assert rbps("simulate", "-m", "local-level", "-n", "60", "-o", "run.npz").exit_code == 0
    result = rbps("fit", "run.npz", "-m", "local-level", *QUICK)
    assert result.exit_code == 0, result.stderr


# ---- serve ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_serve(tmp_path):
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    run = subprocess.Popen(
        [*RBPS, "serve", "--port", str(port)], stderr=subprocess.PIPE, text=True,
        env=os.environ | {"RBPS_STATE_DIR": str(tmp_path)},
    )  # fmt: skip

    def answers():
        try:
            with urlopen(f"http://127.0.0.1:{port}/livez", timeout=60) as answer:
                return answer.status == 200
        except OSError:
            assert run.poll() is None, run.stderr.read()
            return False

    try:
        eventually(answers)
    finally:
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=600)


def test_a_column_with_an_equals_sign(rbps, tmp_path):
    (tmp_path / "a.csv").write_text("t,q=5,pump\n0,1,2\n1,2,3\n2,1,2\n")
    found = rbps("simulate", "-m", "tanks", "--inputs", tmp_path / "a.csv", "--map", "pump=q=5",
                 "-o", "run.csv")  # fmt: skip
    assert found.exit_code == 0, found.stderr
    assert engine.Series.read(tmp_path / "run.csv").u[:, 0].tolist() == [1.0, 2.0, 1.0]


@pytest.mark.parametrize("hold", ["zoh", "foh", "past"])
def test_inputs_between_samples(rbps, tmp_path, hold):
    u = 3.0 + np.sin(0.4 * np.arange(30))
    engine_series = engine.Series(np.full(30, 5.0), u, dt=4.0)
    write_series(engine_series, tmp_path / "u.csv")
    found = rbps(
        "simulate",
        "-m",
        "tanks",
        "--inputs",
        tmp_path / "u.csv",
        "--map",
        "pump=u",
        "--no-noise",
        "--hold",
        hold,
        "-o",
        "run.csv",
    )
    assert found.exit_code == 0, found.stderr
    run = engine.Series.read(tmp_path / "run.csv")
    assert run.hold == hold
    model = engine.get_model("tanks")
    exact = engine.free_run(model, None, engine_series.replace(hold=hold)).y
    np.testing.assert_allclose(run.y, exact, rtol=1e-9)


def test_another_hold_is_refused(rbps, tmp_path):
    (tmp_path / "u.csv").write_text("t,y,u\n0,1,1\n4,1,1\n")
    found = rbps(
        "simulate", "-m", "tanks", "--inputs", "u.csv", "--map", "pump=u", "--hold", "soft"
    )
    assert found.exit_code == 2
    assert "hold = 'soft'; one of zoh, foh, past" in found.stderr


def test_serve_with_a_wrong_setting(rbps, monkeypatch):
    monkeypatch.setenv("RBPS_WORKERS", "many")
    result = rbps("serve", "--port", "9999")
    assert result.exit_code == 2
    assert "RBPS_WORKERS='many' is not of type int" in result.stderr


# ---- the fit of the simulation ------------------------------------------------------------------


@pytest.fixture
def run(rbps, tmp_path):
    command = "simulate -m oscillator --excite drive=steps:1:2 -n 300 --dt 0.02 -o run.csv"
    assert rbps(*command.split()).exit_code == 0
    return tmp_path / "run.csv"


@pytest.mark.slow
def test_the_simulation_is_fitted_first(rbps, run, tmp_path):
    asked = ("fit", run, "-m", "oscillator", "--free", "omega,zeta", "--set", "omega=7")
    found = rbps(
        *asked,
        "--method",
        "simulation",
        "-o",
        "fit.json",
        "--report",
        "fit.html",
        "--plot",
        "figures",
    )
    assert found.exit_code == 0, found.output
    document = json.loads((tmp_path / "fit.json").read_text())
    model = engine.get_model("oscillator")
    series = read_series(run)
    least = engine.fit_simulation(model, series, {"omega": 7.0}, free=["omega", "zeta"])
    assert document["estimate"]["omega"]["value"] == least.theta["omega"]
    assert f"simulation wrong by {words.with_unit(least.rmse, '1')} rms" in found.stdout
    assert "Standard errors allow for errors of the run that last" in found.stdout
    assert "Simulation" in (tmp_path / "fit.html").read_text()
    assert list((tmp_path / "figures").glob("outputs*.svg"))
    assert not list(tmp_path.rglob("*.state"))
    em = rbps(*asked, "--first", "simulation", *QUICK, "--json").json()
    assert em["trace"]["theta"]["omega"][0] == least.theta["omega"]
    assert "EM started from the fit of the simulation" in em["message"]


@pytest.mark.parametrize("option", [("--starts", 2), ("--first", "simulation"), ("-n", 5)])
def test_what_the_fit_of_the_simulation_has_no_use_for(rbps, run, option):
    result = rbps("fit", run, "-m", "oscillator", "--method", "simulation", *option)
    assert result.exit_code == 2
    assert "is not for --method simulation" in result.stderr


def test_an_exact_method_for_a_model_that_is_not_linear_is_wrong_usage(rbps, tmp_path):
    assert rbps("new", "pendulum.py").exit_code == 0
    command = "simulate -m pendulum.py --excite torque=steps:1:2 -n 100 --dt 0.02 -o run.csv"
    assert rbps(*command.split()).exit_code == 0
    result = rbps("fit", "run.csv", "-m", "pendulum.py", "--method", "rts-em")
    assert result.exit_code == 2
    assert "--method rts-em: model 'pendulum' is not linear Gaussian" in result.stderr
    assert "use quasi-newton" in result.stderr


@pytest.mark.long
def test_steps_that_are_too_long_are_said_and_may_be_made_shorter(rbps, run, tmp_path):
    assert rbps("new", "pendulum.py").exit_code == 0
    command = "simulate -m pendulum.py --excite torque=steps:20:1 -n 60 --dt 0.25 -o coarse.csv"
    assert rbps(*command.split()).exit_code == 0
    asked = "fit", "coarse.csv", "-m", "pendulum.py", "--method", "simulation", "--json"
    assert "with 2 steps a sample the free run changes by" in rbps(*asked).json()["message"]
    assert "with 2 steps" not in rbps(*asked, "--substeps", 8).json()["message"]
    refused = rbps("fit", run, "-m", "linear-2", "--substeps", 2)
    assert refused.exit_code == 2


@pytest.mark.long
def test_a_column_that_may_hold_the_times_is_pointed_out(rbps, flows, tmp_path):
    """A step of 1 that nobody asked for is said, and with which column it would not be."""
    lines = (tmp_path / flows).read_text().splitlines()
    rows = [f"{0.5 * k},{line.split(',')[-1]}" for k, line in enumerate(lines[1:])]
    (tmp_path / "hours.csv").write_text("\n".join(["hours,flow", *rows]))
    said = rbps("fit", "hours.csv", "-m", "local-level", *QUICK).stderr
    assert "a step of 1 s is assumed; else --dt STEP, or, as 'hours' counts up evenly" in said
    named = rbps("fit", "hours.csv", "-m", "local-level", "--time", "hours", *QUICK).stderr
    assert "100 samples every 0.5 h" in named
    assert "assumed" not in named
