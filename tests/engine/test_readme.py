"""What the README and the Guide show runs, and gives the answers that they promise."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import engine

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "service" / "guide" / "pages").glob("*.md"))
ONLY_README = (ROOT / "README.md").read_text(encoding="utf-8")
README = "\n".join([ONLY_README, *(page.read_text(encoding="utf-8") for page in PAGES)])
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
SHELL = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)


def run(text: str, capsys) -> tuple[dict, str]:
    """The names a block leaves, and what it prints."""
    (block,) = (one for one in BLOCKS if text in one)
    names: dict = {"np": np, "engine": engine}  # a block may go on with what one before it imported
    exec(compile(block, "README.md", "exec"), names)
    return names, capsys.readouterr().out


def test_all_blocks_are_run_here():
    """Glider, drive, the Nile twice; three of the cart; three of a measured record; saving; an experiment."""
    assert len(BLOCKS) == 12


def test_the_readme_is_short_and_its_links_lead_somewhere():
    assert len(ONLY_README.splitlines()) <= 180
    for page in (ROOT / "README.md", *PAGES):
        for link in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in link:
                assert (page.parent / link).exists(), (page.name, link)


@pytest.mark.long
def test_from_equations_to_a_model(capsys):
    """The tutorial's blocks one after the other: the check is content, and the values are found again."""
    text = (ROOT / "service" / "guide" / "pages" / "equations.md").read_text(encoding="utf-8")
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(block, "equations.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "Shapes, values and covariances are right" in printed
    found = names["found"]
    for name, truth in (("m", 2.0), ("c", 3.0)):
        assert found.theta[name] == pytest.approx(truth, rel=0.05)
    assert "no influence" in printed  # of the variances


@pytest.mark.slow
def test_the_designed_experiment(capsys):
    """A set, the input that tells its causes apart, the name."""
    names, printed = run("design_experiment(", capsys)
    first, last = printed.splitlines()[0], printed.splitlines()[-1]
    text = (ROOT / "service" / "guide" / "pages" / "design.md").read_text(encoding="utf-8")
    assert first in text
    name, size = last.rsplit(" ", 1)
    assert name == "named drag:velocity"
    assert float(size) == pytest.approx(0.6, abs=0.06)
    assert names["design"].probability > 0.95


@pytest.mark.long
def test_the_measured_record_in_short(capsys):
    _, printed = run("found.adopted)  # named step:flow True", capsys)
    assert printed == "named step:flow True\n"


@pytest.mark.long
def test_the_measured_record(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "service" / "guide" / "pages" / "measured.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    names: dict = {}
    for block in blocks:
        exec(compile(block, "measured.md", "exec"), names)
    promised = re.search(r"^# (named step:flow [\d.]+)$", text, re.MULTILINE)[1]
    printed = capsys.readouterr().out
    assert promised in printed
    assert "True" in printed.split(promised)[1]  # adopted
    assert (tmp_path / "nile.html").is_file()
    size, error = re.search(r"^# step_flow = (-[\d.]+) \+- (\d+) ", text, re.MULTILINE).groups()
    stepped = names["stepped"]
    assert stepped.theta["step_flow"] == pytest.approx(float(size), abs=0.05 * float(error))
    assert stepped.theta["step_flow_time"] == 1899.0
    assert f"step_flow = {stepped.theta['step_flow']:.2f} +- {error}" in printed


def test_results_are_kept_as_the_guide_says(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run('fit.save("fit.json")', capsys)
    assert (tmp_path / "fit.json").is_file()


@pytest.mark.slow
def test_the_glider_in_short(capsys, monkeypatch):
    """The block runs as it stands, on fewer samples, with fewer iterations and few effects."""
    (block,) = (one for one in BLOCKS if "glider" in one)
    for long, short in (("400", "100"), ("n_iterations=100", "n_iterations=5")):
        assert long in block
        block = block.replace(long, short)
    few = partial(engine.diagnose, effects=["bias"])
    monkeypatch.setattr(engine, "diagnose", few)
    names: dict = {}
    exec(compile(block, "README.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "(100, 2) (100, 2)" in printed
    assert printed.rstrip().endswith(names["looked"].verdict.value)


@pytest.mark.slow
def test_the_glider(capsys):
    """The truth is within all intervals: c as simulated, q and r at their defaults."""
    names, printed = run("glider", capsys)
    assert "Converged" in printed
    truth = names["glider"].theta({"c": 0.3})
    low, high = names["errors"].interval(0.95).T
    assert ((low < truth) & (truth < high)).all(), (low, high)
    assert names["errors"].settled
    assert 0.02 < high[0] - low[0] < 0.1
    shown = re.search(r"print\(errors\)  # (c = [\d.]+ \+- [\d.]+)", README)
    value, error = (float(x) for x in re.findall(r"\d\.\d+", shown[1]))
    assert value == pytest.approx(names["found"].theta["c"], abs=0.002)
    assert error == pytest.approx(names["errors"].values[0], abs=0.002)
    assert "(400, 2) (400, 2)" in printed
    assert names["looked"].verdict.value == "nothing"
    assert printed.rstrip().endswith("nothing")


@pytest.mark.slow
def test_the_drive(capsys):
    """Named, with the size that was hidden inside its interval, and the frictions restored."""
    names, printed = run('found.report("drive.html")', capsys)
    found = names["found"]
    assert found.verdict.value == "named"
    (cause,) = found.causes
    assert cause.effect == "drag:velocity"
    size, error = re.search(r"\[drag:velocity\]: (\S+) \+- (\S+)", printed).groups()
    assert abs(float(size) - 0.6) < 1.96 * float(error)
    promised = README.split("It prints (the whole page")[1].split("| what the simulation")[0]
    assert f"Quadratic drag of velocity [drag:velocity]: {size} +- {error}" in promised
    for line in printed.splitlines()[2:7]:  # what it gains, too
        assert f"    {line}" in promised


@pytest.mark.slow
def test_the_nile(capsys):
    names, printed = run("found.causes[0].parameters)\n", capsys)
    assert "named step:flow" in printed
    assert names["found"].causes[0].parameters["step_flow_time"] == 1899.0
    (line,) = (one for one in README.splitlines() if one.startswith("# named step:flow {"))
    assert float(re.search(r"'step_flow': (-[\d.]+)", line)[1]) == pytest.approx(
        names["found"].causes[0].parameters["step_flow"], rel=0.02
    )


def test_requests_of_the_http_page_are_valid():
    """Every body that a curl line sends is one that the service accepts."""
    from service.schemas import EstimateRequest

    bodies = re.findall(r"-d '(\{.*?\})'", "\n".join(SHELL), re.DOTALL)
    assert bodies
    for body in bodies:
        request = EstimateRequest.model_validate(json.loads(body))
        assert np.isnan(np.array(request.series[0].y, dtype=float)[3]).all()
        assert request.options.particles == 50
    upload = re.search(r"'request=(\{.*?\})'", README)[1]
    assert json.loads(upload) == {"kind": "estimate", "model": "local-level"}


def test_commands_of_the_shell_page_exist_with_their_options(tmp_path, monkeypatch):
    """Every ``rbps`` line is parsed by the commands themselves, without being run."""
    import typer

    from service.cli.commands import app

    monkeypatch.chdir(tmp_path)
    results = ("free.json", "result.json", "drag.json", "plain.json", "step.json", "run.json")
    for name in ("flows.csv", "nile.csv", "run.csv", "data.csv", *results):
        Path(name).touch()
    root = typer.main.get_command(app)
    text = "\n".join(SHELL).replace("\\\n", " ")
    lines = [one.split(" #")[0] for one in text.splitlines() if one.startswith("rbps ")]
    assert len(lines) >= 5
    for line in lines:
        words = shlex.split(line)[1:]
        command = root.get_command(None, words[0])
        assert command is not None, line
        command.make_context(words[0], words[1:], resilient_parsing=False)


def test_every_setting_of_the_service_is_documented_with_its_default():
    from service.settings import Settings

    rows = re.findall(r"^\| `RBPS_(\w+)` \|(.*?)\|(.+)\|$", README, re.MULTILINE)
    assert sorted(name for name, _, _ in rows) == sorted(
        one.name.upper() for one in fields(Settings)
    )
    of_the_machine = {"WORKERS": "number of cores", "STATE_DIR": "`~/.local/state/rbps`"}
    told = {name: default.strip() for name, default, _ in rows}
    assert {name: told.pop(name) for name in of_the_machine} == of_the_machine
    env = {f"RBPS_{name}": text.strip("`") for name, text in told.items() if text}
    default = Settings(state_dir=Path())
    assert Settings.from_env(env | {"RBPS_STATE_DIR": "."}) == default
    without = {name for name, text in told.items() if not text}
    assert without == {one.name.upper() for one in fields(Settings) if not getattr(default, one.name)
                       and one.type in ("str", "Path | None")}  # fmt: skip


def test_what_compose_asks_for_is_documented():
    compose = (Path(__file__).parents[2] / "docker" / "compose.yaml").read_text()
    assert set(re.findall(r"\$\{(\w+)", compose)) == {"POSTGRES_PASSWORD"}
    assert "`POSTGRES_PASSWORD`" in README


def test_the_settings_that_are_promised_exist():
    assert np.all([name in README for name in ("RBPS_", "python -m engine.compile_kernels")])
    for module in re.findall(r"python -m (engine\.\w+|service[.\w]*|tests[.\w]*)", README):
        path = Path(__file__).parents[2].joinpath(*module.split("."))
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module
