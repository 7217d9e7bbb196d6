"""``rbps design``: from a diagnosis' JSON, from a saved diagnosis, and before any experiment."""

import csv
import json

import numpy as np
import pytest

import engine
from engine.data.files import write_series
from engine.design.candidates import before_any
from engine.design.rivals import of_diagnosis
from service import designs

BEFORE = (
    "design", "-m", "oscillator", "--cause", "drag:velocity=0.3", "--cause", "coulomb:velocity=0.5",
    "--dt", "0.05", "-n", "60", "--tries", "32", "-q",
)  # fmt: skip
RANGE = ("--input", "drive=-1:1:20")


@pytest.mark.slow
def test_before_any_experiment(rbps, tmp_path):
    run = rbps(*BEFORE, *RANGE, "-o", "in.csv", "--report", "in.html")
    assert run.exit_code == 0, run.stderr
    assert "right name" in run.stdout
    rows = list(csv.reader((tmp_path / "in.csv").read_text().splitlines()))
    u = np.array(rows[1:], dtype=float)
    assert rows[0] == ["t", "drive"]
    assert u.shape == (60, 2)
    assert np.abs(u[:, 1]).max() <= 1.0
    assert np.abs(np.diff(u[:, 1])).max() <= 1.0 + 1e-9
    assert "Input drive" in (tmp_path / "in.html").read_text()
    again = rbps(*BEFORE, *RANGE, "--json").json()["design"]
    np.testing.assert_allclose(again["experiment"]["u"]["drive"], u[:, 1], rtol=1e-8)


@pytest.mark.slow
def test_bounds_come_from_a_file_and_options_on_top(rbps, tmp_path):
    given = {"inputs": {"drive": {"low": -2, "high": 2, "forbidden": [[-0.1, 0.1]]}}, "dt": 0.1}
    (tmp_path / "bounds.json").write_text(json.dumps(given))
    bands = ("--stopband", "drive=0.5:1", "--stopband", "drive=4:5")
    run = rbps(*BEFORE, "--bounds", "bounds.json", "--limit", "position=-3:3", *bands, "--json")
    bounds = run.json()["design"]["bounds"]
    assert bounds["inputs"]["drive"]["forbidden"] == [[-0.1, 0.1]]
    assert bounds["inputs"]["drive"]["stopbands"] == [[0.5, 1.0], [4.0, 5.0]]
    assert bounds["states"] == {"position": [-3.0, 3.0]}
    assert bounds["dt"] == 0.05


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(0)
    model = engine.get_model("oscillator", effects=["coulomb:velocity"])
    u = np.repeat(rng.uniform(-1, 1, 20), 10)
    theta = model.theta({"coulomb_velocity": 1.0})
    return engine.simulate(model, theta, 200, rng, u=u, dt=0.05, hold="past").series


@pytest.mark.slow
def test_from_a_diagnosis(rbps, tmp_path, record):
    write_series(record, tmp_path / "run.csv")
    kinds = ["coulomb:velocity", "drag:velocity"]
    found = rbps(
        "diagnose",
        "run.csv",
        "-m",
        "oscillator",
        "--effects",
        ",".join(kinds),
        "-o",
        "found.json",
        "-q",
    )
    assert found.exit_code == 0, found.stderr
    own = ("--input", "drive=-1:1", "-n", "60", "--tries", "16", "-q", "--json")
    run = rbps("design", "found.json", *own)
    assert run.exit_code == 0, run.stderr
    design = run.json()["design"]
    assert {c["effect"] for c in design["causes"]} == {"coulomb:velocity", "drag:velocity"}
    assert design["dt"] == pytest.approx(0.05)
    saved = engine.diagnose(engine.get_model("oscillator"), record, effects=kinds, seed=0)
    saved.save(tmp_path / "found.rbps")
    there = rbps("design", "found.rbps", *own).json()["design"]
    assert [c["effect"] for c in there["causes"]] == [c["effect"] for c in design["causes"]]
    assert there["experiment"]["u"] == design["experiment"]["u"]
    for told in ("D", "probability"):  # the file's times have been rounded
        np.testing.assert_allclose(there["experiment"][told], design["experiment"][told], rtol=1e-6)
    _tells_all_that_it_knows(saved, json.loads((tmp_path / "found.json").read_text())["diagnosis"])
    assert (there["bounds"]["hold"], there["bounds"]["substeps"]) == ("past", 1)
    assert design["bounds"]["hold"] == "past"
    wrong = rbps("design", "found.json", "--cause", "cubic:velocity", *own[:-1])
    assert wrong.exit_code == 2
    assert "the diagnosis weighed" in wrong.stderr
    document = json.loads((tmp_path / "found.json").read_text())
    document["diagnosis"]["next"]["model"]["name"] = "mine"
    (tmp_path / "of-mine.json").write_text(json.dumps(document))
    wrong = rbps("design", "of-mine.json", *own[:-1])
    assert wrong.exit_code == 2
    assert "it is of model 'mine', which is not registered; say where it is" in wrong.stderr


def _tells_all_that_it_knows(saved, document):
    """The causes of a document are those of the diagnosis, with their values and covariances."""
    asked = designs.next_of(document)
    known = of_diagnosis(saved, None).candidates
    read = before_any(saved.model, asked["causes"], asked["theta"], 0.05, asked["free"]).candidates
    for one, other in zip(known, read, strict=True):
        assert (one.name, one.free, one.further) == (other.name, other.free, other.further)
        np.testing.assert_allclose(other.theta, one.theta)
        np.testing.assert_allclose(other.covariance, one.covariance)
        assert np.diag(one.covariance).min() > 0.0


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ((*BEFORE,), "bounds.inputs is missing"),
        ((*BEFORE, "--input", "drive=1"), "NAME=LOW:HIGH[:RATE] is needed"),
        ((*BEFORE, "--input", "drive=a:b"), "holds what is no number"),
        ((*BEFORE, "--input", "drive=1:-1"), "bounds.inputs.drive.low"),
        ((*BEFORE, *RANGE, "--limit", "height=0:1"), "bounds.states.height"),
        ((*BEFORE, *RANGE, "--stopband", "4:5"), "--stopband 4:5: NAME=LOW:HIGH is needed"),
        ((*BEFORE, *RANGE, "--stopband", "drive=5:4"), "bounds.inputs.drive.stopbands[0]"),
        ((*BEFORE, "--stopband", "drive=4:5"), "give its range too"),
        (("design", "--input", "drive=-1:1"), "DIAGNOSIS is missing"),
        ((*BEFORE, *RANGE, "-o", "in.txt"), "the ending must be .csv"),
    ],
)
def test_what_cannot_be_asked(rbps, args, said):
    run = rbps(*args)
    assert run.exit_code == 2
    assert said in run.stderr


def test_a_file_that_is_no_diagnosis(rbps, tmp_path):
    (tmp_path / "other.json").write_text("{}")
    run = rbps("design", "other.json", *RANGE)
    assert run.exit_code == 2
    assert "neither the JSON of" in run.stderr
