"""The catalogue of effects, and completion by the shell."""

import os
import subprocess

import pytest

from engine.diagnose import all_effects, effect_kinds
from engine.diagnose.effects.setting import Setting
from engine.models.registry import get_model
from tests.cli.conftest import RBPS


@pytest.mark.long
def test_every_kind_with_equation_units_and_look_alikes(rbps):
    found = {one["name"].partition(":")[0]: one for one in rbps("effects", "--json").json()}
    shipped = [get_model(name) for name in ("servo", "oscillator", "local-level")]
    there = {one.kind for model in shipped for one in all_effects(Setting(model))}
    assert there <= set(found) <= set(effect_kinds())
    assert all(one["equation"] and one["title"] and one["parameters"] for one in found.values())
    text = rbps("effects").stdout
    assert "coulomb:" in text
    assert "looks like: " in text
    assert "rbps effects --model MODEL" in text


def test_those_of_a_model_with_its_units(rbps):
    found = rbps("effects", "-m", "servo", "--json").json()
    model = get_model("servo")
    assert [one["name"] for one in found] == [one.name for one in all_effects(Setting(model))]
    text = rbps("effects", "-m", "servo", "--kind", "drag").stdout
    assert "drag_velocity [1/m]" in text
    assert "coulomb:" not in text
    assert rbps("new", "mine.py").exit_code == 0
    assert "angle" in rbps("effects", "-m", "mine.py").stdout
    wrong = rbps("effects", "--time-unit", " ")
    assert wrong.exit_code == 2
    assert "--time-unit: a unit such as s, min or year" in wrong.stderr
    wrong = rbps("effects", "--kind", "magic")
    assert wrong.exit_code == 2
    assert "--kind magic: there is no such kind; kinds are" in wrong.stderr


def test_those_of_a_model_whose_times_are_no_seconds(rbps):
    text = rbps("effects", "-m", "local-level", "--kind", "drift", "--time-unit", "year").stdout
    assert "1e8 m^3/year" in text
    assert "/s]" not in text
    kinds = rbps("effects", "--kind", "slow-sensor", "--time-unit", "min", "--json").json()
    assert [one["parameters"][0]["unit"] for one in kinds] == ["min"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("typed", "offered", "others"),
    [("rbps di", ["diagnose"], ["fit"]), ("rbps fit -m local", ["local-level"], ["servo"])],
)
def test_the_shell_completes(typed, offered, others):
    env = {
        "_RBPS_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(typed.count(" ")),
    }
    run = subprocess.run(RBPS, env=os.environ | env, capture_output=True, text=True, check=False)
    words = run.stdout.split()
    assert set(offered) <= set(words)
    assert not set(others) & set(words)


@pytest.mark.slow
def test_state_files_have_a_folder_of_their_own_and_go_with_it(rbps, tmp_path):
    command = "simulate -m oscillator --excite drive=steps:1:2 -n 100 --dt 0.02 -o run.csv"
    assert rbps(*command.split()).exit_code == 0
    asked = ("fit", "run.csv", "-m", "oscillator", "--free", "omega", "--no-standard-errors")
    short = rbps(*asked, "-n", "1", "--particles", "20")
    assert short.exit_code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == [".rbps", "run.csv"]
    assert "rbps fit --resume .rbps/run.state --iterations" in short.stdout
    assert rbps(*asked, "--method", "rts-em", "-n", "300", "-o", "fit.json").exit_code == 0
    assert [p.name for p in (tmp_path / ".rbps").iterdir()] == ["run.state"]  # of the first only
    (tmp_path / ".rbps" / "run.state").unlink()
    assert rbps(*asked, "--method", "rts-em", "-n", "300").exit_code == 0
    assert not (tmp_path / ".rbps").exists()
