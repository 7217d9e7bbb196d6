"""On a pseudo-terminal: the progress bar, Ctrl-C, and the same numbers after going on."""

import json
import re
import subprocess

import numpy as np
import pytest

import engine
from engine.data.files import write_series
from service.cli import design, diagnose
from service.cli.state import Asked
from service.cli.state_file import read
from tests.cli.conftest import RBPS
from tests.patience import eventually

# enough particles that there is time to type within the iterations
FIT = (
    *("data.csv", "-m", "mixed-4", "--set", "theta_2=0.9", "--free", "theta_2,theta_5"),
    *("-n", "30", "--particles", "250", "--seed", "5", "--method", "rbps-em"),
    "--no-standard-errors",
)  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "data.csv"
    model = engine.get_model("mixed-4")
    write_series(engine.simulate(model, None, 60, np.random.default_rng(1)).series, path)
    return path


@pytest.fixture
def folder(tmp_path, data):
    (tmp_path / "data.csv").write_bytes(data.read_bytes())
    return tmp_path


@pytest.fixture(scope="module")
def uninterrupted(data):
    run = subprocess.run(
        [*RBPS, "fit", *FIT, "--json"], cwd=data.parent, capture_output=True, check=True
    )
    return json.loads(run.stdout)


def same_numbers(one, other):
    """Bit for bit, but for the seconds that each iteration took, and for what a file is labelled with."""
    labels = ("name", "tags", "data", "created")
    texts = [
        json.dumps(
            {k: v for k, v in d.items() if k not in labels}
            | {"trace": d["trace"] | {"seconds": None}}
        )
        for d in (one, other)
    ]
    return texts[0] == texts[1]


@pytest.mark.slow
def test_a_bar_with_the_time_that_is_left(folder, terminal):
    run = terminal("fit", *FIT, "--quiet")
    code, quiet = run.end()
    assert code == 0
    assert run.shown == ""
    run = terminal("fit", *FIT)
    run.until(r"━+.* \d+/30 +\d+:\d\d +log-likelihood -?\d+\.\d\d")
    code, shouted = run.end()
    assert code == 0
    assert "data.csv: 60 samples every 1 s; y1, y2\r\n" in run.shown
    assert shouted == quiet
    assert "theta_2" in shouted


@pytest.mark.slow
def test_ctrl_c_and_going_on_give_the_same_numbers(folder, terminal, uninterrupted):
    run = terminal("fit", *FIT, "--out", "result.json")
    run.until(r" ([5-9]|[12]\d)/30")  # the bar is drawn anew now and then: numbers are left out
    run.type(b"\x03")
    code, printed = run.end()
    assert code == 130
    assert printed == ""
    k = int(re.search(r"interrupted after (\d+) of 30 iterations. Go on with", run.shown)[1])
    assert 5 <= k < 30
    assert "rbps fit --resume .rbps/result.state" in run.shown
    assert "Traceback" not in run.shown
    assert not (folder / "result.json").exists()

    run = terminal("fit", "--resume", ".rbps/result.state")
    run.until(rf"going on after iteration {k}\b")
    assert run.end()[0] == 0
    assert same_numbers(json.loads((folder / "result.json").read_text()), uninterrupted)


@pytest.mark.slow
def test_ctrl_c_in_a_later_start(folder, terminal):
    several = (*FIT, "--starts", "2", "--out", "result.json")
    whole = terminal("fit", *several)
    assert whole.end()[0] == 0
    expected = json.loads((folder / "result.json").read_text())
    assert len(expected["starts"]) == 2
    (folder / "result.json").unlink()
    run = terminal("fit", *several)
    run.until("start 2 of 2, log-likelihood")
    run.type(b"\x03")
    assert run.end()[0] == 130
    told = re.search(r"interrupted in (start 2 of 2|choice), after (\d+) of 30 it", run.shown)
    assert told, run.shown
    refused = terminal("fit", "--resume", ".rbps/result.state", "-n", "40")
    assert refused.end()[0] == 2
    assert "cannot be changed where there are several starts" in refused.shown
    run = terminal("fit", "--resume", ".rbps/result.state")
    run.until(rf"going on after iteration {told[2]} of {told[1]}")
    assert run.end()[0] == 0
    assert same_numbers(json.loads((folder / "result.json").read_text()), expected)
    assert not (folder / ".rbps" / "result.state").exists()


@pytest.mark.slow
def test_ctrl_c_after_the_iterations_loses_none(folder, terminal, uninterrupted):
    run = terminal("fit", *FIT, "--state", "kept.state")
    run.until("smoothing|comparing")
    run.type(b"\x03")
    if run.end()[0] == 130:
        assert "interrupted after 30 of 30 iterations" in run.shown
    asked, rows, _ = read(folder / "kept.state", Asked)
    assert rows.shape == (31, 9)
    assert asked.data == [str(folder / "data.csv")]
    again = subprocess.run(
        [*RBPS, "fit", "--resume", "kept.state", "--json"],
        cwd=folder,
        capture_output=True,
        check=True,
    )
    assert same_numbers(json.loads(again.stdout), uninterrupted)


@pytest.mark.slow
def test_what_follows_the_iterations_claims_no_time(folder, terminal):
    """The bar of the iterations is full or gone, and nobody says how long standard errors take."""
    run = terminal("fit", *FIT[:-1])  # with standard errors
    run.until(r"━ +standard errors")
    shown = re.findall(r"[━╸╺]+([^━╸╺\r\n]*?) *standard errors", run.shown)
    assert shown
    assert all(text.strip() == "" for text in shown), shown
    run.type(b"\x03")
    code, _ = run.end()
    assert code == 130
    assert re.search(r"So far: theta_1 = [\d.]+, theta_2 = [\d.]+", run.shown), run.shown


@pytest.mark.slow
def test_a_killed_run_leaves_its_iterations(folder, uninterrupted):
    run = subprocess.Popen([*RBPS, "fit", *FIT, "-n", "100000", "-q"], cwd=folder)
    path = folder / ".rbps" / "data.state"
    eventually(path.exists)
    run.kill()
    run.wait()
    asked, rows, _ = read(path, Asked)
    assert asked.iterations == 100000
    assert len(rows) > 1
    theta = uninterrupted["trace"]["theta"]
    for i, name in enumerate(engine.get_model("mixed-4").parameter_names):
        assert rows[:31, i].tolist() == theta[name][: len(rows)]


DIAGNOSE = (
    *("diagnose", "data.csv", "-m", "mixed-4", "--seed", "2"),
    *("--effects", "bias,gain,cubic,drag,lag,step,latent,level,variance"),
)  # fmt: skip


def without_times(page):
    return [line for line in page.splitlines() if " s in all: " not in line]


@pytest.mark.slow
def test_ctrl_c_keeps_what_a_diagnosis_knows_by_then(folder, terminal):
    run = terminal(*DIAGNOSE, "--report", "early.html", "--out", "early.json")
    run.until(r"Free-run simulation of \w+: wrong by [^.]")  # as soon as the model is fitted
    run.until("The first screen points to")  # and screened
    run.type(b"\x03")
    code, printed = run.end()
    assert (code, printed) == (130, "")
    assert re.search(r"Go on with\s+rbps diagnose --resume \S+", run.shown)
    assert re.search(r"What is known so far: early.html", run.shown)
    document = json.loads((folder / "early.json").read_text())
    assert document["early"]["screen"]["scores"]
    report = (folder / "early.html").read_text()
    assert "so far" in report
    assert document["early"]["screen"]["scores"][0]["effect"] in report


def interrupted(run):
    """Type Ctrl-C: how many per cent were done, and the command that goes on."""
    run.type(b"\x03")
    code, printed = run.end()
    assert (code, printed) == (130, "")
    assert "Traceback" not in run.shown
    told = re.search(r"interrupted at (\d+) %. Go on with\s+rbps (\w+ --resume \S+)", run.shown)
    assert told, run.shown
    return int(told[1]), told[2].split()


@pytest.mark.slow
def test_ctrl_c_while_diagnosing_and_going_on_end_with_the_same_page(folder, terminal):
    whole = terminal(*DIAGNOSE)
    code, expected = whole.end()
    assert code == 0
    assert not list(folder.rglob("*.state"))

    stages = ("estimating the model", "screening", "calibrating", "")
    at, command = 0, DIAGNOSE
    for stage in stages:
        run = terminal(*command)
        if not stage:
            break
        run.until(rf"━.* \d+/100 .*({stage})")
        before, (at, command) = at, interrupted(run)
        assert at >= before
        assert command[-1] == ".rbps/data-diagnosis.state"
    run.until(rf"going on at {at} %")
    code, page = run.end()
    assert code == 0
    assert at > 5
    assert without_times(page) == without_times(expected)
    assert not list(folder.rglob("*.state"))


@pytest.mark.slow
def test_a_killed_diagnosis_leaves_its_parts(folder):
    few = (*DIAGNOSE[:-1], "bias,gain")
    run = subprocess.Popen([*RBPS, *few, "-q", "--state", "kept.state"], cwd=folder)
    path = folder / "kept.state"
    eventually(lambda: path.exists() or run.poll() is not None)
    run.kill()
    run.wait()
    _, percent, parts = read(path, diagnose.Asked)
    assert [name for name, _ in parts][:2] == ["asked", "fit mixed-4"]
    again = [*RBPS, "diagnose", "--resume", "kept.state", "--json", "--report", "out.html"]
    for _ in range(2):  # what is kept by name stays, and shows the result once more
        found = subprocess.run(again, cwd=folder, capture_output=True, check=True)
        assert json.loads(found.stdout)["diagnosis"]["model"] == "mixed-4"
    _, after, more = read(path, diagnose.Asked)
    assert len(more) >= len(parts)
    assert after[0, 0] >= percent[0, 0]  # it may have been killed near its end
    assert "mixed-4" in (folder / "out.html").read_text()


DESIGN = (
    *("design", "-m", "oscillator", "--cause", "drag:velocity=0.3", "--cause", "coulomb:velocity=0.5"),
    *("--dt", "0.05", "-n", "120", "--tries", "80", "--input", "drive=-1:1:20"),
)  # fmt: skip


@pytest.mark.slow
def test_ctrl_c_while_designing_and_going_on_end_with_the_same_input(folder, terminal):
    whole = terminal(*DESIGN, "--out", "whole.csv")
    code, expected = whole.end()
    assert code == 0
    assert not list(folder.rglob("*.state"))
    at, command = 0, (*DESIGN, "--out", "input.csv")
    for percent in (r"[1-9]\d*", r"[4-9]\d"):
        run = terminal(*command)
        run.until(rf"━.* {percent}/100 .*trying inputs")
        before, (at, command) = at, interrupted(run)
        assert at >= before
        assert command[-1] == ".rbps/input.state"
        assert not (folder / "input.csv").exists()
    refused = terminal(*command, "--seed", "2")
    assert refused.end()[0] == 2
    assert "--seed cannot be given with it" in refused.shown
    run = terminal(*command)
    run.until(rf"going on at {at} %")
    code, table = run.end()
    assert code == 0
    assert table == expected.replace("whole.csv", "input.csv")
    assert (folder / "input.csv").read_bytes() == (folder / "whole.csv").read_bytes()
    assert not list(folder.rglob("*.state"))
    assert not (folder / ".rbps").exists()


@pytest.mark.slow
def test_a_killed_design_leaves_its_parts(folder):
    run = subprocess.Popen([*RBPS, *DESIGN, "-q", "--state", "kept.state"], cwd=folder)
    path = folder / "kept.state"
    eventually(lambda: path.exists() or run.poll() is not None)
    run.kill()
    run.wait()
    _, _, parts = read(path, design.Asked)
    assert [name for name, _ in parts][:2] == ["asked", "inputs: 1"]
    again = [*RBPS, "design", "--resume", "kept.state", "--json"]
    found = subprocess.run(again, cwd=folder, capture_output=True, check=True)
    assert len(json.loads(found.stdout)["design"]["experiment"]["u"]["drive"]) == 120
    _, _, more = read(path, design.Asked)
    assert len(more) >= len(parts)


@pytest.mark.slow
def test_plain_lines_where_the_terminal_is_dumb_or_none(folder):
    run = subprocess.run(
        [*RBPS, "fit", *FIT], cwd=folder, capture_output=True, text=True, check=True
    )
    lines = run.stderr.splitlines()
    assert all(line.startswith("rbps: ") for line in lines)
    assert "\x1b" not in run.stderr + run.stdout
    tenths = [line for line in lines if " of 30, log-likelihood " in line]
    assert [int(line.split()[1]) for line in tenths] == list(range(3, 31, 3))
    assert tenths[0].endswith(" left")
    assert not tenths[-1].endswith(" left")
