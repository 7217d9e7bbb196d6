"""Results kept in files and pickled, with their models by name, by file, by text, or as told."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

import engine
from engine.data import nile
from engine.errors import OptionError
from engine.models.files import read_models
from tests.engine.models.test_model_files import write

SERIES = engine.Series(np.sin(np.arange(30.0)) * 0.1)


@pytest.fixture(scope="module")
def level():
    model = engine.get_model("local-level")
    return engine.rbps_em(model, nile(), free=["q"], n_particles=10, n_iterations=2, seed=1)


def same(one, other):
    assert str(one) == str(other)
    for name in ("trace", "log_likelihood", "ess", "seconds", "collapsed", "memory", "theta"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert (one.free, one.outcome, one.not_estimated) == (
        other.free,
        other.outcome,
        other.not_estimated,
    )


@pytest.mark.long
def test_an_estimate_of_a_registered_model_and_going_on_with_it(level, tmp_path):
    found = engine.load(level.save(tmp_path / "fit.json"))
    same(found, level)
    assert found.model is level.model
    same(pickle.loads(pickle.dumps(level)), level)
    options = {"free": ["q"], "n_particles": 10, "n_iterations": 3, "seed": 1}
    on = [engine.rbps_em(f.model, nile(), resume=f.checkpoint, **options) for f in (level, found)]
    np.testing.assert_array_equal(on[0].trace, on[1].trace)


def test_an_estimate_kept_before_there_was_anything_to_remember(level, tmp_path):
    path = level.save(tmp_path / "fit.json")
    document = json.loads(path.read_text())
    del next(part for part in document.values() if isinstance(part, dict) and "ess" in part)[
        "memory"
    ]
    path.write_text(json.dumps(document))
    found = engine.load(path)
    assert found.memory.shape == (2, 0)
    assert len(engine.rbps_em(found.model, nile(), resume=found, n_iterations=3).trace) == 4


def test_errors_with_a_tie_and_a_note(tmp_path):
    model = engine.get_model("local-level")
    errors = engine.StandardErrors(
        model,
        model.theta(),
        ("q", "r"),
        np.diag([4.0, 0.0]),
        *np.eye(3, 2),
        settled=False,
        warning="some",
        tied=("r",),
    )
    found = engine.load(errors.save(tmp_path / "errors.json"))
    assert str(found) == str(errors)
    assert not found.settled
    np.testing.assert_array_equal(found.values, errors.values)
    for name in ("covariance", "score", "score_error", "relative_error"):
        np.testing.assert_array_equal(getattr(found, name), getattr(errors, name))
    assert engine.load(replace(errors, names=(), covariance=np.empty((0, 0))).save(tmp_path / "no"))


def test_an_extended_model_by_name_and_effects(tmp_path):
    model = engine.get_model("local-level", effects=["step:flow"])
    found = engine.rbps_em(model, nile(), free=["q"], n_particles=10, n_iterations=1)
    document = json.loads(found.save(tmp_path / "fit.json").read_text())
    assert document["model"]["registered"] == {"name": "local-level", "effects": ["step:flow"]}
    again = engine.load(tmp_path / "fit.json")
    same(again, found)


def test_a_model_of_a_file(tmp_path):
    path = write(tmp_path, "valve")
    fit = engine.fit_simulation(engine.model_from(str(path)), SERIES)
    saved = fit.save(tmp_path / "fit.json")
    again = engine.load(saved)
    assert str(again) == str(fit)
    np.testing.assert_array_equal(again.runs[0].y, fit.runs[0].y)
    np.testing.assert_array_equal(again.covariance, fit.covariance)
    path.unlink()
    with pytest.raises(OptionError, match=r"valve.py, where model 'valve' comes from, has gone"):
        engine.load(saved)
    np.testing.assert_array_equal(engine.load(saved, run_source=True).runs[0].y, fit.runs[0].y)
    write(tmp_path, "valve", ("0.01", "0.02"))
    with pytest.raises(OptionError, match="is not what it was when this was saved"):
        engine.load(saved)
    assert engine.load(saved, model=fit.model).model is fit.model
    with pytest.raises(OptionError, match="the result has the parameters c; model 'servo' has"):
        engine.load(saved, model=engine.get_model("servo"))


def test_a_model_that_nobody_can_find_is_asked_for(level, tmp_path):
    model = engine.get_model("local-level")
    names: dict = {"engine": engine, "known": model}
    cell = """
def dynamics(*arguments):
    return known.dynamics(*arguments)
mine = engine.MixedModel(
    name="mine", dynamics=dynamics, measurement=known.measurement, initial=known.initial,
    linear=known.linear, outputs=known.outputs, parameters=known.parameters)
"""
    exec(compile(cell, "<cell 1>", "exec"), names)
    found = engine.rbps_em(names["mine"], nile(), n_particles=10, n_iterations=1)
    saved = found.save(tmp_path / "fit.json")
    with pytest.raises(OptionError, match="neither registered nor from a file"):
        engine.load(saved)
    same(engine.load(saved, model=names["mine"]), found)


def kept(model, path):
    """A result of a model, in a file."""
    n = len(model.parameters)
    errors = engine.StandardErrors(model, model.theta(), (), np.empty((0, 0)), *np.zeros((3, n)))
    return errors.save(path / "errors.json")


def other_reading(a, u, t, theta):
    h, C, R = engine.get_model("servo").measurement(a, u, t, theta)
    return h, 10.0 * np.asarray(C), R


def other_start(theta):
    density, z1, P1 = engine.get_model("servo").initial(theta)
    return density, z1, 2.0 * np.asarray(P1)


def other_step(a, u, t, dt, theta):
    f, A, Q = engine.get_model("servo").dynamics(a, u, t, dt, theta)
    return f, A, np.where(t > 5.0, 2.0, 1.0) * np.asarray(Q)  # later only


@pytest.mark.parametrize(
    ("what", "other"),
    [
        ("measurement", other_reading),
        ("initial", other_start),
        ("dynamics", other_step),
        ("continuous", True),
        ("outputs", {"y": "mm"}),
    ],
)
def test_another_model_of_a_registered_name_is_not_taken_for_it(what, other, tmp_path):
    servo = engine.get_model("servo")
    model = replace(servo, **{what: other})
    saved = kept(model, tmp_path)
    with pytest.raises(
        OptionError, match=rf"the registered one differs in {what}\); load\(path, m"
    ):
        engine.load(saved)
    with pytest.raises(OptionError, match=f"not the one of this result, whose {what} is different"):
        engine.load(saved, model=servo)
    assert engine.load(saved, model=model).model is model
    with pytest.raises(OptionError, match=f"whose {what} is different"):
        engine.load(kept(servo, tmp_path), model=model)


def test_bounds_and_defaults_of_a_registered_model_come_back(tmp_path):
    servo = engine.get_model("servo")
    wider = [
        replace(p, bounds=(p.bounds[0], np.inf), default=1.1 * p.default) for p in servo.parameters
    ]
    model = replace(servo, parameters=wider)
    saved = kept(model, tmp_path)
    assert engine.load(saved).model.parameters == model.parameters
    with pytest.raises(OptionError, match="whose default of M, bounds of M, default of Fv"):
        engine.load(saved, model=servo)


MADE = """
def made(start):
    return engine.MixedModel(
        name="lag", dynamics=dynamics, measurement=measurement,
        initial=lambda theta: (engine.Gaussian([start], [[0.1]]), [], np.zeros((0, 0))),
        nonlinear={"x": ""}, outputs={"reading": "m"}, parameters=[engine.Parameter("c", 0.5)])

mine = made(0.0)
"""


def test_a_model_of_a_files_function_is_not_taken_for_the_one_in_the_file(tmp_path):
    path = write(tmp_path, "lag")
    path.write_text(path.read_text().partition("mine =")[0] + MADE)
    module = read_models(path).module
    assert (
        engine.load(kept(module.mine, tmp_path)).model.start(module.mine.theta()).density.mean == 0
    )
    other = module.made(5.0)
    saved = kept(other, tmp_path)
    with pytest.raises(OptionError, match="nor from a file that gives it again; load"):
        engine.load(saved)
    with pytest.raises(OptionError, match="whose initial is different"):
        engine.load(saved, model=module.mine)
    assert engine.load(saved, model=other).model is other


def test_a_file_that_was_saved_without_a_fingerprint(tmp_path):
    servo = engine.get_model("servo")
    saved = kept(servo, tmp_path)
    document = json.loads(saved.read_text())
    del document["model"]["fingerprint"]
    saved.write_text(json.dumps(document))
    assert engine.load(saved).model is servo
    assert engine.load(saved, model=replace(servo, measurement=other_reading))


def test_models_with_outliers_are_made_again_of_what_they_were_made_of(tmp_path):
    own = engine.model_from(str(write(tmp_path, "valve")))
    level = engine.get_model("local-level")
    for base in (level, own, engine.with_mixture(level, name="other", channels=("flow",))):
        for model in (
            engine.with_student_t(base, nu_default=7.0),
            engine.with_mixture(base, "dynamics", ratio_default=30.0),
        ):
            found = engine.load(kept(model, tmp_path)).model
            assert found.parameters == model.parameters
            assert found.scale_states == model.scale_states
    changed = replace(
        engine.with_mixture(level), measurement=engine.with_student_t(level).measurement
    )
    with pytest.raises(OptionError, match="neither registered nor from a file"):
        engine.load(kept(changed, tmp_path))


def test_a_general_model_with_other_noise_is_refused(tmp_path):
    model = engine.as_general(engine.get_model("local-level"))
    saved = kept(model, tmp_path)
    assert engine.load(saved, model=model).model is model
    heavy = replace(model, measurement_noise=lambda theta: engine.StudentT(1.0, 4.0))
    with pytest.raises(OptionError, match="whose measurement_noise is different"):
        engine.load(saved, model=heavy)


@pytest.mark.long
def test_a_diagnosis_in_a_file_and_pickled(clear_diagnosis, tmp_path):
    def told(found):
        document = found.to_dict()
        return {key: document[key] for key in document if key not in ("seconds", "page")}

    saved = clear_diagnosis.save(tmp_path / "diagnosis.json")
    for again in (engine.load(saved), pickle.loads(pickle.dumps(clear_diagnosis))):
        assert again.verdict is clear_diagnosis.verdict
        assert again.causes == clear_diagnosis.causes
        assert told(again) == told(clear_diagnosis)


@pytest.mark.parametrize("text", ["no JSON", "{}", '{"kind": 1}', "[]"])
def test_another_file_is_refused(tmp_path, text):
    (tmp_path / "other.json").write_text(text)
    with pytest.raises(OptionError, match=r"other.json: this is not a result that save"):
        engine.load(tmp_path / "other.json")
    with pytest.raises(OptionError, match="a Series cannot be saved"):
        engine.save(SERIES, tmp_path / "other.json")


@pytest.mark.long
def test_a_diagnosis_of_several_records(tmp_path):
    model, rng = engine.get_model("linear-2"), np.random.default_rng(0)
    runs = [engine.simulate(model, None, n, rng).series for n in (120, 60, 60)]
    found = engine.diagnose(model, runs[:2], test=runs[2:], effects=["bias"], seed=1)
    again = engine.load(found.save(tmp_path / "diagnosis.json"))
    before, after = ({k: v for k, v in one.to_dict().items() if k not in ("seconds", "page")}
                     for one in (found, again))  # fmt: skip
    assert after == before
