"""Models from files: found, checked, read again when they change, forgotten when they go."""

from types import SimpleNamespace

import pytest

from engine.diagnose.extended import in_the_library
from engine.errors import ModelError, OptionError
from engine.models import registry
from engine.models.files import model_from, read_models
from engine.presentation.model_check import model_check

TEXT = """
import numpy as np
import engine

def dynamics(a, u, t, dt, theta):
    return [theta.c * a[:, 0]], np.zeros((1, 0)), [[0.01]]

def measurement(a, u, t, theta):
    return [a[:, 0]], np.zeros((1, 0)), [[0.01]]

def initial(theta):
    return engine.Gaussian([0.0], [[0.1]]), [], np.zeros((0, 0))

mine = engine.MixedModel(
    name="NAME", dynamics=dynamics, measurement=measurement, initial=initial,
    nonlinear={"x": ""}, outputs={"reading": "m"}, parameters=[engine.Parameter("c", 0.5)])
"""


def write(folder, name, change=("", "")):
    path = folder / f"{name}.py"
    path.write_text(
        TEXT.replace("NAME", name).replace(*change) if change[0] else TEXT.replace("NAME", name)
    )
    return path


@pytest.fixture(autouse=True)
def nothing_stays():
    yield
    registry._own.references.clear()
    registry._read_files()
    assert not registry._own.names
    assert not registry._own.errors


def test_one_is_named_and_the_only_one_need_not_be(tmp_path):
    path = write(tmp_path, "valve")
    assert model_from(f"{path}:mine").name == model_from(str(path)).name == "valve"
    with pytest.raises(
        OptionError, match=r"valve.py:nope: the file has no 'nope'; its models are mine"
    ):
        model_from(f"{path}:nope")
    with pytest.raises(OptionError, match="'np' is a module; a MixedModel is needed"):
        model_from(f"{path}:np")
    with pytest.raises(OptionError, match="there is no such file"):
        model_from(str(tmp_path / "none.py"))
    with pytest.raises(ModelError, match=r"NameError: .*nowhere.*\(line 1[67]\)"):
        model_from(str(write(tmp_path, "broken", ("engine.Parameter", "nowhere.Parameter"))))


def test_registered_ones_are_read_again_when_their_file_changes(tmp_path):
    path = write(tmp_path, "valve")
    assert registry.register_files([f"{path}:mine"]) == ["valve"]
    found = SimpleNamespace(model=registry.get_model("valve"), causes=[], substeps=1)
    assert "get_model" not in in_the_library(found)  # elsewhere no model is called so
    assert "valve" in registry.model_names()
    before, first = registry.get_model("valve"), registry.source_of("valve")
    assert registry.get_model("valve") is before
    write(tmp_path, "valve", ("0.5", "0.7"))  # of the same length, within the same second
    after = registry.get_model("valve")
    assert after.parameters[0].default == 0.7
    assert registry.source_of("valve") != first
    path.write_text("a b")
    with pytest.raises(
        OptionError, match=r"no model is registered as 'valve'.*SyntaxError"
    ) as told:
        registry.get_model("valve")
    assert str(tmp_path) not in str(told.value)
    assert "SyntaxError" in registry.plugin_errors()["valve.py"]
    assert str(tmp_path) not in registry.plugin_errors()["valve.py"]
    write(tmp_path, "valve")
    assert registry.source_of("valve") is None  # nobody has asked for it yet
    assert registry.get_model("valve").parameters[0].default == 0.5
    path.unlink()
    assert "valve" not in registry.model_names()
    assert "there is no such file" in registry.plugin_errors()["valve.py"]


def test_a_file_belongs_to_what_it_imports(tmp_path):
    helper = tmp_path / "rbps_test_constants.py"
    helper.write_text("C = 0.25\n")
    write(tmp_path, "valve", ("import engine", "import engine\nfrom rbps_test_constants import C"))
    text = (tmp_path / "valve.py").read_text()
    (tmp_path / "valve.py").write_text(text.replace('"c", 0.5', '"c", C'))
    registry.register_files(
        [str(tmp_path)]
    )  # the folder: the helper holds no model, and is no error
    assert registry.get_model("valve").parameters[0].default == 0.25
    first = registry.source_of("valve")
    helper.write_text("C = 0.3  # another\n")
    assert registry.get_model("valve").parameters[0].default == 0.3
    assert registry.source_of("valve") != first
    assert registry.plugin_errors() == {}


def test_a_model_with_two_names_is_one(tmp_path):
    """``model = mine`` at the end of a file made it ask which of the two was meant."""
    path = write(tmp_path, "valve")
    path.write_text(f"{path.read_text()}model = mine\n")
    assert model_from(str(path)) is not None
    assert model_from(f"{path}:model").name == "valve"
    assert registry.register_files([str(path)]) == ["valve"]


def test_a_broken_file_of_a_folder_stops_nothing_and_one_that_is_named_does(tmp_path):
    write(tmp_path, "valve")
    (tmp_path / "broken.py").write_text("1 / 0")
    assert registry.register_files([str(tmp_path)]) == ["valve"]
    assert "ZeroDivisionError" in registry.plugin_errors()["broken.py"]
    with pytest.raises(
        ModelError, match=r"broken.py: ZeroDivisionError: division by zero \(line 1\)"
    ):
        registry.register_files([str(tmp_path / "broken.py")])
    assert "valve" in registry.model_names()
    with pytest.raises(OptionError, match=r"neither a \.py file nor a folder"):
        registry.register_files([str(tmp_path / "nowhere")])


def test_the_name_of_another_model_is_refused(tmp_path):
    with pytest.raises(ModelError, match="a model named 'servo' is already registered"):
        registry.register_files([str(write(tmp_path, "servo"))])
    assert registry.get_model("servo").nu == 1
    assert registry.plugin_errors() == {}  # what was refused is not among what is in use and broken


def test_what_the_check_says(tmp_path):
    linear = model_from(str(write(tmp_path, "valve")))
    said = model_check(linear)
    assert "rts-em is exact" in said[1]
    assert any("Without bounds on both sides: c" in one for one in said)
    assert any("engine.continuous" in one for one in said)
    assert any("lists no equations" in one for one in said)
    cubic = model_from(str(write(tmp_path, "cubic", ("a[:, 0]], np", "a[:, 0] ** 3], np"))))
    assert "quasi-newton and rbps-em apply" in model_check(cubic)[1]
    slow = write(tmp_path, "slow", ("theta.c * a[:, 0]", "round(theta.c, 9) * a[:, 0]"))
    assert any(
        "dynamics takes one parameter vector" in one for one in model_check(model_from(str(slow)))
    )
    number = write(tmp_path, "number", ("theta.c * a[:, 0]", "float(theta.c) * a[:, 0]"))
    assert not any("one parameter vector" in one for one in model_check(model_from(str(number))))
    both = write(tmp_path, "both", ("theta.c * a[:, 0]", "round(theta.c, 9) * a[:, 0]"))
    both.write_text(
        both.read_text().replace("return [a[:, 0]]", "return [round(theta.c, 9) * a[:, 0]]")
    )
    assert any(
        "dynamics and measurement take one parameter" in one
        for one in model_check(model_from(str(both)))
    )
    wrong = write(tmp_path, "wrong", ("[[0.01]]", "[[-0.01]]"))
    model = read_models(wrong).models["mine"]
    assert model_check(model)[0].startswith(
        "Cannot be used: model 'wrong', dynamics: Q has the negative"
    )


def test_a_file_that_reads_itself_is_told_how_not_to(tmp_path):
    """As a script does that loads a saved estimate of its own model; once it went on without end."""
    path = tmp_path / "script.py"
    path.write_text(f"import engine\nengine.model_from({str(path)!r})\n")
    with pytest.raises(ModelError, match=r"while it is imported.*__main__"):
        model_from(str(path))
    assert model_from(str(write(tmp_path, "script"))).name == "script"  # and can be read after that
