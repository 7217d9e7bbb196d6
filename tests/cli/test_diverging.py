"""A simulation that diverges on held-out data is said to, in place of an error that is no number."""

import json

import numpy as np
import pytest

from engine.data.files import read_series
from engine.models.files import model_from
from engine.presentation.held_out import held_out

CUBIC = """
import numpy as np
import engine

def dynamics(a, u, t, dt, theta):
    return [theta.c * a[:, 0] + u[0] + 0.1 * a[:, 0] ** 3], np.zeros((1, 0)), [[1e-6]]

def measurement(a, u, t, theta):
    return [a[:, 0]], np.zeros((1, 0)), [[1e-4]]

def initial(theta):
    return engine.Gaussian([0.0], [[1e-4]]), [], np.zeros((0, 0))

cubic = engine.MixedModel(
    name="cubic", dynamics=dynamics, measurement=measurement, initial=initial, nonlinear={"x": "m"},
    inputs={"push": "m"}, outputs={"reading": "m"}, parameters=[engine.Parameter("c", 0.5, "1", (0.0, 0.9))])
"""


@pytest.fixture
def folder(tmp_path):
    """Records of small pushes, and of some that carry the model away."""
    (tmp_path / "cubic.py").write_text(CUBIC)
    rng = np.random.default_rng(0)
    for name, size in (("small", 0.2), ("large", 20.0)):
        u = size * rng.standard_normal(60)
        y, x = [], 0.0
        for push in u:
            y.append(x + 0.01 * rng.standard_normal())
            x = np.clip(0.6 * x + push + 0.1 * x**3, -5.0, 5.0)
        rows = "".join(f"{a},{b}\n" for a, b in zip(y, u, strict=True))
        (tmp_path / f"{name}.csv").write_text("reading,push\n" + rows)
    return tmp_path


def test_it_is_said_by_the_shell_the_report_and_the_comparison(rbps, folder):
    fitted = rbps(
        "fit", "small.csv", "-m", "cubic.py", "--method", "simulation", "--test", "large.csv",
        "--out", "a.json", "--report", "a.html",
    )  # fmt: skip
    assert fitted.exit_code == 0, fitted.stderr
    assert "on held-out data the simulation of reading diverges" in fitted.stdout
    assert "Simulation of reading: it diverges." in (folder / "a.html").read_text()
    document = json.loads((folder / "a.json").read_text())
    assert document["held_out"]["outputs"][0]["rmse"] is None
    compared = rbps("compare", "a.json", "a.json", "--report", "both.html")
    (line,) = (one for one in compared.stdout.splitlines() if "held-out error of reading" in one)
    assert line.split()[-2:] == ["diverges", "diverges"]
    assert "<td>diverges</td>" in (folder / "both.html").read_text()


def test_a_document_has_none_for_it_before_it_is_json(folder):
    model = model_from(str(folder / "cubic.py"))
    test = read_series(folder / "large.csv", y=["reading"], u=["push"])
    (output,) = held_out(model, None, [test])["outputs"]
    assert (output["rmse"], output["fit"]) == (None, None)
