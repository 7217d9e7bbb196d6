"""Wrong input: a message that names the option or column, the right exit code, never a traceback."""

# ruff: noqa: E501 - a table

import errno
import json
import os
import re
from importlib.metadata import version

import numpy as np
import pytest
from scipy.io import savemat

import engine
from engine.diagnose.search import pipeline as causes
from engine.errors import EngineError
from service.cli import diagnose, outputs
from service.cli.state_file import FORMAT, read, write
from tests.cli.test_commands import MINE, QUICK

LEVEL = ("-m", "local-level")
SERVO = ("simulate", "-m", "servo", "-n", "10")

WRONG = {
    "no data": (("fit", *LEVEL), "DATA is missing"),
    "no such file": (("fit", "none.csv", *LEVEL), "none.csv"),
    "a folder": (("fit", ".", *LEVEL), "'.'"),
    "no model": (("fit", "flows.csv"), "--model is missing: 'rbps models'"),
    "no such model": (("fit", "flows.csv", "-m", "nile"), "Registered are linear-2, local-level"),
    "no such file of a model": (("fit", "flows.csv", "-m", "his.py:x"), "his.py: there is no such"),
    "no such model in a file": (("models", "mine.py:his"), "no 'his'; its models are mine"),
    "not a model": (("models", "mine.py:np"), "'np' is a module; a MixedModel is needed"),
    "a broken file of a model": (("models", "broken.py"), "NameError: name 'oops' is not defined (line 2)"),
    "no option": (("fit", "flows.csv", "--speed", "9"), "--speed"),
    "no value": (("fit", "flows.csv", *LEVEL, "--set", "q"), "--set q: NAME=VALUE is needed"),
    "no number": (("fit", "flows.csv", *LEVEL, "--set", "q=many"), "--set q=many: 'many' is not a number"),
    "no such parameter": (("fit", "flows.csv", *LEVEL, "--set", "x=1"), "--set: model 'local-level' has no parameter 'x'; it has q, r, level"),
    "out of bounds": (("fit", "flows.csv", *LEVEL, "--fix", "r=-1"), "--fix: parameter 'r' = -1 is not within"),
    "free and fixed": (("fit", "flows.csv", *LEVEL, "--free", "q", "--fix", "q=1"), "--free q: it is also given with --fix"),
    "nothing free": (("fit", "flows.csv", *LEVEL, "--fix", "q=1", "--fix", "r=1", "--fix", "level=1"), "--fix: no parameter is left"),
    "unknown free": (("fit", "flows.csv", *LEVEL, "--free", "z"), "--free: model 'local-level' has no parameter 'z'"),
    "unknown method": (("fit", "flows.csv", *LEVEL, "--method", "newton"), "--method newton: choose one of quasi-newton, rbps-em, ps-em, rts-em"),
    "too few particles": (("fit", "flows.csv", *LEVEL, "--particles", "1"), "Invalid value for '--particles'"),
    "too many particles": (("fit", "flows.csv", *LEVEL, "--particles", "999999999"), "Invalid value for '--particles'"),
    "too many trajectories": (("fit", "flows.csv", *LEVEL, "--trajectories", "999999999"), "Invalid value for '--trajectories'"),
    "a seed too large": (("fit", "flows.csv", *LEVEL, "--seed", "99999999999999999999999"), "Invalid value for '--seed'"),
    "a unit of time": (("fit", "flows.csv", *LEVEL, "--time-unit", "m/s"), "time_unit = 'm/s'; a unit such as 's' or 'year' is needed, in letters"),
    "a unit of time of nothing": (("simulate", *LEVEL, "-n", "9", "--time-unit", "1 s"), "--time-unit: time_unit = '1 s'"),
    "a value twice": (("fit", "flows.csv", *LEVEL, "--set", "q=1", "--set", "q=2"), "--set q=2: q is given twice; leave one of them out"),
    "a channel twice": (("fit", "flows.csv", *LEVEL, "--map", "flow=flow", "--map", "flow=year"), "--map flow=year: flow is given twice"),
    "a file twice": (("fit", "flows.csv", "short.csv", "./flows.csv", *LEVEL), "the same file is named twice"),
    "a test that was fitted": (("fit", "flows.csv", *LEVEL, "--test", "again.csv"), "test is record 0, which the model is fitted to"),
    "a test on another clock": (("fit", "flows.csv", *LEVEL, "--test", "hours.csv"), "times of one series are in s, of another in h"),
    "unknown channel": (("fit", "flows.csv", *LEVEL, "--map", "rain=flow"), "--map rain=flow: model 'local-level' has no output or input 'rain'; it has flow"),
    "unknown column": (("fit", "flows.csv", *LEVEL, "--map", "flow=rain"), "--map flow=rain: flows.csv has no column 'rain'; there are year, flow"),
    "no column": (("fit", "rain.csv", "-m", "mine.py"), "rain.csv: no column for the output 'reading'; say which it is with --map reading=COLUMN. There are 'year', 'flow', 'rain'"),
    "no column of times": (("fit", "flows.csv", *LEVEL, "--time", "t"), "no column 't'"),
    "text in a column": (("fit", "text.csv", *LEVEL), "text.csv, line 3, column 'flow': 'wet' is not a number"),
    "no text": (("fit", "noise.csv", *LEVEL), "noise.csv, line 1: not UTF-8 text"),
    "an ending": (("fit", "flows.xlsx", *LEVEL), "flows.xlsx: the ending must be .csv, .mat or .npz"),
    "a negative step": (("fit", "flows.csv", *LEVEL, "--dt", "-1"), "dt = -1.0; a positive time step"),
    "unknown effect": (("fit", "flows.csv", *LEVEL, "--with", "ghost:flow"), "--with: effect 'ghost:flow' is not known"),
    "an effect elsewhere": (("fit", "flows.csv", *LEVEL, "--with", "bias:rain"), "--with: effect 'bias' cannot enter model 'local-level' at 'rain'; channels are flow"),
    "no folder": (("fit", "flows.csv", *LEVEL, "-o", "no/where.json"), "--out no/where.json: there is no folder"),
    "no html": (("fit", "flows.csv", *LEVEL, "--report", "out.pdf"), "the ending must be .html"),
    "figures in a file": (("fit", "flows.csv", *LEVEL, "--plot", "flows.csv"), "--plot flows.csv: this is a file; a folder is needed"),
    "not a state": (("fit", "--resume", "flows.csv"), "--resume flows.csv: this is not a state file"),
    "no state": (("fit", "--resume", "none.state"), "--resume none.state: there is no such file"),
    "a pickle": (("fit", "--resume", "evil.state"), "--resume evil.state: this is not a state file"),
    "a diagnosis' state": (("fit", "--resume", "other.state"), "'rbps diagnose --resume other.state'"),
    "an estimation's state of before": (("diagnose", "--resume", "before.state"), "'rbps fit --resume before.state'"),
    "no state to diagnose": (("diagnose", "--resume", "flows.csv"), "not a state file of 'rbps diagnose'"),
    "resume a diagnosis with a seed": (("diagnose", "--resume", "any.state", "--seed", "2"), "--seed cannot be given with it"),
    "nothing to diagnose": (("diagnose", "-m", "local-level"), "DATA is missing"),
    "resume with another seed": (("fit", "--resume", "any.state", "--seed", "2"), "--seed cannot be given with it"),
    "resume with data": (("fit", "flows.csv", "--resume", "any.state"), "DATA cannot be given with it"),
    "no extra column": (("diagnose", "flows.csv", *LEVEL, "--extra", "rain"), "--extra rain: flows.csv has no column 'rain'"),
    "held out": (("diagnose", "flows.csv", *LEVEL, "--held-out", "0.6"), "less than or equal to 0.5"),
    "held out beside a test": (
        ("diagnose", "flows.csv", *LEVEL, "--held-out", "0", "--test", "flows.csv"),
        "--held-out 0: --test is what is held out then",
    ),
    "alpha": (("diagnose", "flows.csv", *LEVEL, "--alpha", "5"), "--alpha 5: a probability"),
    "effects to look for": (("diagnose", "flows.csv", *LEVEL, "--effects", "ghost"), "--effects ghost: there is no such effect"),
    "a short series": (("diagnose", "short.csv", *LEVEL), "only 3 rows hold a measurement; a diagnosis needs at least 30, of all records together, as it fits the model"),
    "no length": (("simulate", *LEVEL), "--samples is missing"),
    "no input": (SERVO, "model 'servo' has the input 'drive'"),
    "an odd input": ((*SERVO, "--excite", "drive=noise:1:1"), "KIND:SIZE:SECONDS is needed"),
    "an unknown input": ((*SERVO, "--excite", "wind=sine:1:1"), "--excite wind: model 'servo' has no such input; it has drive"),
    "no size": (("simulate", *LEVEL, "-n", "9", "--with", "bias:flow"), "--with bias:flow: NAME=VALUE is needed"),
    "effects of no model": (("models", "--effects"), "need the name of a model"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "flows.csv").write_text(
        "year,flow\n" + "".join(f"{k},{k % 7}\n" for k in range(40))
    )
    (tmp_path / "again.csv").write_text((tmp_path / "flows.csv").read_text())
    (tmp_path / "hours.csv").write_text("t [h],flow\n0,1\n1,2\n3,1\n")
    (tmp_path / "short.csv").write_text("flow\n1\n2\n3\n")
    (tmp_path / "text.csv").write_text("flow\n1\nwet\n")
    (tmp_path / "noise.csv").write_bytes(bytes(range(128, 256)))
    (tmp_path / "flows.xlsx").write_bytes(b"PK")
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "broken.py").write_text("import engine\noops\n")
    write(tmp_path / "other.state", diagnose.Asked(data="flows.csv", model="m"), np.zeros((1, 1)))
    told = json.dumps({"rbps_state": FORMAT, "data": ["flows.csv"], "model": "m"})  # no command yet
    none = np.frombuffer(b"[]", np.uint8)
    with (tmp_path / "before.state").open("wb") as stream:
        np.savez(stream, asked=told, rows=np.zeros((1, 7)), left=none)
    with (tmp_path / "evil.state").open("wb") as stream:
        np.savez(stream, asked=np.array([{}], dtype=object), rows=np.zeros((1, 7)))
    (tmp_path / "rain.csv").write_text("year,flow,rain\n1,2,3\n2,2,1\n3,1,1\n")
    return tmp_path


@pytest.mark.long
@pytest.mark.parametrize("case", WRONG)
def test_wrong_usage_and_data(case, rbps, folder):
    arguments, message = WRONG[case]
    result = rbps(*arguments)
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split()), result.stderr
    assert "Traceback" not in result.output
    assert result.stdout == ""


def test_errors_for_machines(rbps, folder):
    result = rbps("fit", "flows.csv", "-m", "nile", "--json")
    assert result.exit_code == 2
    assert result.json()["error"]["code"] == 2
    assert "there is no such model" in result.json()["error"]["message"]


def test_a_model_that_fails(rbps, folder):
    """At one time only, which no check beforehand happens to look at."""
    text = MINE.replace("return [theta.c", "1 / (t != 7.0)\n    return [theta.c")
    (folder / "mine.py").write_text(text)
    (folder / "data.csv").write_text("reading,push\n" + "1,2\n" * 40)
    result = rbps("fit", "data.csv", "-m", "mine.py", *QUICK)
    assert result.exit_code == 1
    assert (
        "ZeroDivisionError: division by zero (mine.py, line 6, in dynamics; called at t = 7"
        in result.stderr
    )


def test_an_estimation_that_diverges(rbps, folder):
    text = MINE.replace("theta.c * a[:, 0] + u[0]", "1e200 * (theta.c + 2) * (1 + a[:, 0] ** 2)")
    (folder / "mine.py").write_text(text)
    (folder / "data.csv").write_text("reading,push\n" + "1,2\n" * 10)
    result = rbps("fit", "data.csv", "-m", "mine.py", *QUICK, "--json")
    assert result.exit_code == 1
    error = json.loads(result.stdout)["error"]
    assert error["code"] == 1
    assert error["message"]
    assert not (folder / ".rbps" / "data.state").exists()


@pytest.mark.long
def test_data_that_changed_since(rbps, folder):
    assert rbps("fit", "flows.csv", *LEVEL, *QUICK).exit_code == 0
    with (folder / "flows.csv").open("a") as stream:
        stream.write("40,5\n")
    result = rbps("fit", "--resume", ".rbps/flows.state", "-n", "5")
    assert result.exit_code == 2
    assert "flows.csv has changed since the estimation began" in result.stderr
    (folder / "flows.csv").unlink()
    assert "flows.csv is gone" in rbps("fit", "--resume", ".rbps/flows.state").stderr


def test_a_model_that_changed_since(rbps, folder):
    (folder / "data.csv").write_text("reading,push\n" + "1,2\n" * 10)
    assert rbps("fit", "data.csv", "-m", "mine.py", *QUICK).exit_code == 0
    (folder / "mine.py").write_text(MINE.replace("0.5", "0.6"))
    result = rbps("fit", "--resume", ".rbps/data.state")
    assert result.exit_code == 2
    assert "mine.py has changed since the estimation began" in result.stderr


@pytest.mark.long
def test_a_diagnosis_of_data_or_by_a_version_that_changed_since(rbps, folder):
    asked = ("diagnose", "flows.csv", *LEVEL, "--effects", "step", "--state", "kept.state")
    assert rbps(*asked).exit_code == 0
    state, rows, parts = read(folder / "kept.state", diagnose.Asked)
    state.version = "0.0.1"
    write(folder / "old.state", state, rows, parts)
    told = rbps("diagnose", "--resume", "old.state")
    assert (told.exit_code, "begun by rbps 0.0.1, whose numbers may differ" in told.stderr) == (
        2,
        True,
    )
    parts[0][1]["other options"] = "0"
    state.version = version("rbps")
    write(folder / "odd.state", state, rows, parts)
    told = rbps("diagnose", "--resume", "odd.state")
    assert (told.exit_code, "of a diagnosis with other options" in told.stderr) == (2, True)
    with (folder / "flows.csv").open("a") as stream:
        stream.write("40,5\n")
    told = rbps("diagnose", "--resume", "kept.state")
    assert (told.exit_code, "changed since the diagnosis began" in told.stderr) == (2, True)


def test_a_folder_that_cannot_be_written_into_is_refused_before_the_work(rbps, folder, monkeypatch):
    able = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and able(path, mode))
    for command in ("fit", "diagnose"):
        told = rbps(command, "flows.csv", *LEVEL)
        assert told.exit_code == 2
        assert re.search(r"--state flows.*\.state: nothing can be written into", told.stderr)


@pytest.mark.long
def test_a_diagnosis_whose_report_cannot_be_written_is_not_lost(rbps, folder, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    asked = ("diagnose", "flows.csv", *LEVEL, "--effects", "step", "--report", "out.html")
    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(outputs, "write_report", full)
        told = rbps(*asked)
    assert told.exit_code == 2
    assert "No space left on device. What was found is kept" in told.stderr
    command = told.stderr.splitlines()[-1].split()
    assert command[1:] == ["diagnose", "--resume", ".rbps/flows-diagnosis.state"]

    def again(*arguments):
        raise AssertionError("this was done before")

    monkeypatch.setattr(causes, "fit_base", again)
    assert rbps(*command[1:]).exit_code == 0
    assert (folder / "out.html").exists()
    assert not (folder / ".rbps" / "flows-diagnosis.state").exists()


def test_the_share_that_is_held_out_is_asked_for(rbps, folder, monkeypatch):
    def seen(*arguments, held_out, **options):
        raise EngineError(f"asked with {held_out}")

    monkeypatch.setattr(engine, "diagnose", seen)
    assert "asked with 0.0" in rbps("diagnose", "flows.csv", *LEVEL, "--held-out", "0").stderr
    assert "asked with 0.2" in rbps("diagnose", "flows.csv", *LEVEL).stderr


@pytest.mark.long
def test_an_estimation_whose_report_cannot_be_written_is_not_lost(rbps, folder, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(outputs, "write_report", full)
        told = rbps("fit", "flows.csv", *LEVEL, *QUICK, "--report", "out.html")
    assert told.exit_code == 2
    assert "No space left on device. What was found is kept" in told.stderr
    command = told.stderr.splitlines()[-1].split()
    assert command[1:] == ["fit", "--resume", ".rbps/flows.state"]
    told = rbps(*command[1:])
    assert (told.exit_code, "going on after iteration" in told.stderr) == (0, True)
    assert (folder / "out.html").exists()


def test_figures_without_matplotlib_are_refused_before_the_work(rbps, folder, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    for command in (("fit", "flows.csv"), ("diagnose", "flows.csv"), ("simulate", "-n", "9")):
        result = rbps(*command, *LEVEL, "--plot", "figures")
        assert result.exit_code == 2
        assert "pip install 'rbps[plot]'" in result.stderr


@pytest.mark.long
def test_what_a_file_holds_that_is_no_table_is_said(rbps, folder):
    savemat(folder / "logged.mat", {"data": {"flow": [1.0, 2.0, 3.0]}})
    result = rbps("fit", "logged.mat", *LEVEL)
    assert result.exit_code == 2
    assert "There are nothing (not usable: 'data' is not" in " ".join(result.output.split())


def test_inputs_in_another_unit_are_refused(rbps, folder):
    rows = "".join(f"{0.02 * k:g},{k % 3}\n" for k in range(20))
    for unit in ("V", "mV"):
        (folder / f"{unit}.csv").write_text(f"t,drive [{unit}]\n{rows}")
        result = rbps("simulate", "-m", "servo", "--inputs", f"{unit}.csv", "-o", "run.csv")
        assert result.exit_code == (0 if unit == "V" else 2)
    assert "channel 'drive' is in mV; model 'servo' takes u channel 'drive' in V" in result.stderr
