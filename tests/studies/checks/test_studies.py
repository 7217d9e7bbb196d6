"""Studies: runs are kept and resumed, verdicts and bounds are right, reports say what was found."""

from __future__ import annotations

import csv
import io
from functools import partial

import numpy as np
import pytest

from tests.studies import em_arms, estimates, lost, states, table_ii, uncertainty
from tests.studies.__main__ import main
from tests.studies.catalogue import ALIASES, STUDIES
from tests.studies.problems import PROBLEMS
from tests.studies.progress import Progress, clock
from tests.studies.realisation import realisation
from tests.studies.report import against
from tests.studies.runner import make_runs, make_study
from tests.studies.statistics import (
    Figure,
    deviation,
    mean,
    rate_bound,
    rate_interval,
    root_mean,
    spread,
    verdict,
)
from tests.studies.store import Store
from tests.studies.study import Arm, Study, StudyError, Table
from tests.studies.times import times


def draw(label, seed, run):
    return {"value": np.random.default_rng([seed, run]).random(), "label": label}


def fail_later(made, seed, run):
    if len(made) == 3:
        raise RuntimeError("stopped")
    made.append(str(run))
    return draw("x", seed, run)


def an_arm(label="x", **settings):
    return Arm("an-arm", partial(draw, label), settings)


def test_finished_runs_are_kept_and_an_interrupted_study_goes_on(tmp_path):
    whole = make_runs(an_arm(), 6, tmp_path / "whole", workers=1)
    made: list[str] = []
    with pytest.raises(RuntimeError, match="stopped"):
        make_runs(Arm("an-arm", partial(fail_later, made), {}), 6, tmp_path / "parts", workers=1)
    assert made != ["0", "1", "2"]  # of all runs, not the first ones
    path = tmp_path / "parts" / "an-arm.csv"
    with path.open("a") as file:
        file.write("3,0.5")  # a line cut short by a crash
    kept = Store(tmp_path / "parts", an_arm(), 0).table()
    assert [row["run"] for row in kept.rows] == sorted(made)
    resumed = make_runs(an_arm(), 6, tmp_path / "parts", workers=1)
    assert resumed.rows == whole.rows
    assert path.read_bytes() == (tmp_path / "whole" / "an-arm.csv").read_bytes()
    assert resumed.wall >= kept.wall


@pytest.mark.slow
def test_processes_give_the_same_rows_in_order(tmp_path):
    one = make_runs(an_arm(), 4, tmp_path / "one", workers=1)
    two = make_runs(an_arm(), 4, tmp_path / "two", workers=2)
    assert one.rows == two.rows


def test_rows_of_other_settings_are_not_continued(tmp_path):
    make_runs(an_arm(M=50), 1, tmp_path, workers=1)
    with pytest.raises(StudyError, match=r"other settings \(M\); use --fresh"):
        make_runs(an_arm(M=100), 2, tmp_path, workers=1)
    with pytest.raises(StudyError, match=r"other settings \(seed\)"):
        make_runs(an_arm(M=50), 2, tmp_path, seed=1, workers=1)
    table = make_runs(an_arm(M=100), 2, tmp_path, workers=1, fresh=True)
    assert len(table) == 2
    assert table.settings["M"] == 100


def test_more_runs_than_asked_for_are_used_and_none_is_made_twice(tmp_path):
    made = []

    def counted(seed, run):
        made.append(run)
        return draw("x", seed, run)

    arm = Arm("an-arm", counted, {})
    make_runs(arm, 3, tmp_path, workers=1)
    assert len(make_runs(arm, 2, tmp_path, workers=1)) == 3
    assert sorted(made) == [0, 1, 2]


def test_selected_arms_are_made_for_the_runs_that_other_arms_tables_name(tmp_path):
    first, later = (Arm(name, partial(draw, name), {}) for name in ("first", "later"))
    study = Study(
        "chosen",
        "Chosen",
        {first: 4},
        lambda tables: str(len(tables["later"])),
        lambda tables, path: None,
        {later: lambda tables: [run for run in range(len(tables["first"])) if run % 2]},
    )
    assert make_study(study, tmp_path, workers=1) == "# Chosen\n\n2\n"
    assert make_runs(later, 0, tmp_path, workers=1).texts("run") == ["1", "3"]
    with pytest.raises(StudyError, match="twice"):
        Study("x", "X", {first: 1}, str, lambda *_: None, {first: lambda tables: []})


def test_shared_runs_count_once_in_the_time_of_all_studies(tmp_path):
    named = [Arm(name, partial(draw, name), {}) for name in "abc"]
    for arm, seconds, workers in zip(named, (600.0, 1200.0, 80.0), (2, 1, 2), strict=True):
        make_runs(arm, 3, tmp_path, workers=1)
        store = Store(tmp_path, arm, 0)
        store.wall = 0.0
        store.spend(seconds, workers)
    a, b, c = named
    studies = [
        Study(name, "t", dict.fromkeys(arms, 3), lambda tables: "", lambda tables, path: None)
        for name, arms in (("one", (a, b)), ("two", (b, c)))
    ]
    text = times(studies, tmp_path)
    assert "Together 21:20 on 2 cores" in text
    assert "| `one` | 2 | 2 | 6 | 20:00 |" in text
    assert "| `two` | 2 | 1 | 3 | 1:20 |" in text


def test_progress_on_a_terminal_and_elsewhere():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    for stream, mark in ((Terminal(), "\r"), (io.StringIO(), "")):
        progress = Progress("name", 4, done=2, stream=stream)
        progress.step()
        progress.step()
        written = stream.getvalue()
        assert "4/4" in written
        assert written.startswith(mark)
        assert ("\r" in written) == bool(mark)
    assert clock(90.2) == "1:30"
    assert clock(3700.0) == "1:01:40"


def test_figures_and_their_errors_agree_with_simulation():
    rng = np.random.default_rng(0)
    x = rng.standard_gamma(2.0, (1500, 400))
    each = [(mean(row), spread(row), root_mean(row)) for row in x]
    for k, middle in enumerate((2.0, np.sqrt(2.0), np.sqrt(2.0))):
        values = np.array([row[k].value for row in each])
        errors = np.array([row[k].error for row in each])
        assert abs(values.mean() / middle - 1.0) < 0.02
        assert abs(errors.mean() / values.std() - 1.0) < 0.12


def test_verdicts():
    ours = Figure(1.0, 0.1, 100)
    assert deviation(ours, 0.8, 100, 0.0) == pytest.approx(0.2 / np.hypot(0.1, 0.1))
    assert deviation(ours, 0.8, 400, 0.0) == pytest.approx(0.2 / np.hypot(0.1, 0.05))
    assert deviation(ours, 0.8, 100, 1.0) < deviation(ours, 0.8, 100, 0.0)
    assert verdict(-1.9) == "agrees"
    assert verdict(-2.5) == "lower by 2.5 s.e. (borderline)"
    assert verdict(3.2) == "differs: higher by 3.2 s.e."
    assert verdict(np.nan) == "cannot be judged"
    assert against("0.50", ours, 100, 2) == ["0.50", "1.00", "0.10", "differs: higher by 3.5 s.e."]


def test_a_figure_that_few_runs_make_is_not_judged():
    assert against("8.69", Figure(99.0, 47.0, 1000), 1000, 2)[-1].startswith("cannot be judged")
    assert against("8.69", Figure(8.6, 0.5, 1000), 1000, 2)[-1] == "agrees"


def test_bounds_on_rates():
    assert rate_bound(0, 100) == pytest.approx(1.0 - 0.05 ** (1 / 100))
    assert rate_bound(0, 200) == pytest.approx(3.0 / 200, rel=0.01)
    assert rate_bound(5, 5) == 1.0
    low, high = rate_interval(4, 130)
    assert low < 4 / 130 < high
    assert rate_interval(0, 50)[0] == 0.0


def rows(outcomes, values):
    return [
        {
            "run": str(k),
            "outcome": outcome,
            "log_likelihood": str(value),
            "iterations": "10",
            "seconds": "1",
            "start.p": "0",
            "theta.p": str(k),
        }
        for k, (outcome, value) in enumerate(zip(outcomes, values, strict=True))
    ]


def test_what_counts_as_lost():
    reference = Table(rows(["CONVERGED"] * 6, [-100.0] * 6), {}, 0.0, 1)
    outcomes = ["CONVERGED", "CONVERGED", "COLLAPSED", "no estimate", "ITERATIONS_USED_UP"]
    table = Table(rows(outcomes, [-104.9, -105.1, -100.0, np.nan, -90.0]), {}, 0.0, 1)
    judged = lost.judge(table, reference)
    assert judged.lost.tolist() == [False, True, True, True, False]
    assert [row["run"] for row in lost.not_lost(table, reference).rows] == ["0", "4"]
    text = lost.summary([("ours", table, reference)])
    assert "| ours | 3 of 5 |" in text
    assert f"{100 * rate_bound(3, 5):.1f} %" in text
    assert "2 no estimate, 1 with an outcome of success" in text
    assert lost.details(table, reference, ("p",)).count("\n") == 5


def test_arms_on_one_model_see_the_same_data():
    one = states.arm("mixed-4").work(0, 3)
    other = states.arm("mixed-4").work(0, 3)
    assert {k: v for k, v in one.items() if k != "seconds"} == {
        k: v for k, v in other.items() if k != "seconds"
    }
    from engine import get_model

    model = get_model("mixed-4")
    assert np.array_equal(realisation(model, 0, 3).y, realisation(model, 0, 3).y)
    assert not np.array_equal(realisation(model, 0, 3).y, realisation(model, 0, 4).y)
    assert PROBLEMS["all-five"].started(0, 3) != PROBLEMS["all-five"].started(0, 4)


def test_starts_are_the_papers():
    five = [PROBLEMS["all-five"].started(0, run) for run in range(300)]
    for name, high in zip(lost.ALL_FIVE, (2.0, 2.0, 0.6, 1.0, np.pi / 2), strict=True):
        values = np.array([start[name] for start in five])
        assert 0.0 <= values.min() < 0.05 * high
        assert 0.95 * high < values.max() <= high


@pytest.mark.long
def test_rmse_tables_in_both_units(tmp_path):
    text = make_study(states.TABLES_1_2, tmp_path, runs=2, workers=1)
    assert "sqrt(1000) = 31.6" in text
    table = make_runs(states.arm("linear-2"), 2, tmp_path, workers=1)
    rmse = np.sqrt(table.numbers("exact.kf.a").mean())
    line = next(line for line in text.splitlines() if line.startswith("| KF | a |"))
    assert f"{rmse:.4f}" in line
    assert f"{rmse * np.sqrt(1000.0):.2f}" in line
    assert (tmp_path / "table-1-2.png").stat().st_size > 1000
    with (tmp_path / "states.linear-2.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 2


def short(problem, label, method="rbps", **options):
    options = {"n_iterations": 3, **options}
    if method != "rts":
        options |= {"n_particles": 8}
    return em_arms.em_arm(problem, label, method, options)


@pytest.mark.slow
def test_estimation_studies_report_every_run(tmp_path):
    arms = {
        "table-I.rts-em": short("table-I", "rts-em", "rts"),
        "table-I.ps-em": short("table-I", "ps-em", "ps"),
        "table-I.rbps-em": short("table-I", "rbps-em"),
        "table-I.default": short("table-I", "default"),
    }
    study = Study(
        "table-I",
        "Table I",
        dict.fromkeys(arms.values(), 3),
        estimates.report_table_i,
        estimates.plot_table_i,
    )
    text = make_study(study, tmp_path, workers=1)
    assert text.count("| RTS-EM |") == 4
    table = make_runs(arms["table-I.rts-em"], 3, tmp_path, workers=1)
    line = next(line for line in text.splitlines() if line.startswith("| RTS-EM | last iterate |"))
    assert "| 9.86 |" in line
    assert f"{100 * table.numbers('last.theta').mean():.2f}" in line
    curves = table.curves("trace.theta")
    assert curves.shape == (3, 4)
    assert np.allclose(curves[:, 0], 0.3)
    assert np.allclose(curves[:, -1], table.numbers("last.theta"), atol=1e-3)


def test_runs_lost_at_the_false_maximum_are_told_and_what_one_would_do_to_the_spreads():
    def table(theta_3, theta_5, log_likelihood):
        rows = [
            {
                "run": str(run),
                "outcome": "CONVERGED",
                "log_likelihood": value,
                "last.theta_3": three,
                "last.theta_5": five,
            }
            for run, (three, five, value) in enumerate(
                zip(theta_3, theta_5, log_likelihood, strict=True)
            )
        ]
        return Table(rows, {}, 0.0, 1)

    good = [0.2, 0.4] * 4
    tables = {
        "all-five.truth": table([0.3] * 10, [0.3] * 10, [0.0] * 10),
        "all-five.rbps-em": table(
            [*good, 1.5, 2.5], [0.3] * 8 + [0.0, 0.01], [0.0] * 8 + [-30.0] * 2
        ),
    }
    text = table_ii._about_rbps(tables)
    assert "2 of 10, of which 2 ended at theta_5 = 0" in text
    assert "theta_3 is 2.00 there" in text
    assert f"theta_3 {np.hypot(np.std(good, ddof=1), 1.7 / np.sqrt(69)):.3f}" in text
    tables["all-five.rbps-em"] = table(good, [0.3] * 8, [0.0] * 8)
    assert "0 of 8, of which 0" in table_ii._about_rbps(tables)


def test_what_runs_lost_by_gradient_steps_would_do_to_the_reported_figures():
    def table(thetas, log_likelihood):
        rows = [
            {
                "run": str(run),
                "outcome": "CONVERGED",
                "log_likelihood": value,
                **{f"last.theta_{k}": end for k, end in enumerate(theta, start=1)},
            }
            for run, (theta, value) in enumerate(zip(thetas, log_likelihood, strict=True))
        ]
        return Table(rows, {}, 0.0, 1)

    good = [(1.0 + d, 1.0 + d, 0.3 + d, 0.9 + d, 0.3 + d) for d in (-0.02, 0.02)] * 4
    far = (1.0, 1.0, 0.3, 0.93, 0.0)
    tables = {
        "all-five.truth": table([*good, far], [0.0] * 9),
        "all-five.gradient-step": table([*good, far], [0.0] * 8 + [-50.0]),
    }
    text = table_ii._about_gradient(tables)
    sd = np.std([theta[4] for theta in good], ddof=1)
    assert "lost is 1 of 9" in text
    assert "theta = (1.00, 1.00, 0.30, 0.93, 0.00)" in text
    assert f"theta_5 is {0.3 / sd:.0f} standard deviations" in text
    assert f"more than {0.03 / sd:.1f}. " in text
    wide = [f"{np.hypot(sd, 0.3 * np.sqrt(k / 69)):.3f}" for k in (1, 2, 3)]
    assert f"spread of theta_5 {', '.join(wide)} (reported 0.057)" in text
    assert (
        f"mean {', '.join(f'{0.3 - 0.3 * k / 69:.3f}' for k in (1, 2, 3))} (reported 0.309)" in text
    )
    tables["all-five.gradient-step"] = table(good, [0.0] * 8)
    assert "lost is 0 of 8" in table_ii._about_gradient(tables)
    tables["all-five.gradient-step"] = table([], [])
    assert table_ii._about_gradient(tables) == ""


def test_a_run_that_fails_is_a_row_and_counts_as_lost():
    arm = em_arms.em_arm("theta-2", "broken", "rts", {"n_iterations": 2})  # not a linear model
    row = arm.work(0, 0)
    assert row["outcome"] == em_arms.FAILED
    assert "ModelError" in row["message"]
    assert np.isnan(row["theta.theta_2"])


def test_standard_errors_report(tmp_path):
    rng = np.random.default_rng(0)
    made = []
    for run in range(200):
        made.append({"run": str(run), "theta.theta": str(0.1 + 0.03 * rng.standard_normal())})
        made[-1] |= {"se.theta": "0.03", "outcome": "CONVERGED"}
        made[-1] |= {"low.theta": "0.05", "high.theta": "inf"} if run < 190 else {}
        made[-1] |= {"low.theta": "0.11", "high.theta": "0.2"} if run < 8 else {}
    close, symmetric, ratio = 7, 9, 11
    cells = uncertainty.case(Table(made, {}, 0.0, 1), "table-I", "theta")
    assert cells[2] == "200"
    assert [cells[k] for k in (close, symmetric, ratio)] == ["yes", "yes", "yes"]
    assert "of 190" in cells[10]
    for row in made:
        row["se.theta"] = "0.02"
    cells = uncertainty.case(Table(made, {}, 0.0, 1), "table-I", "theta")
    assert [cells[k] for k in (close, symmetric, ratio)] == ["no", "no", "yes"]


@pytest.mark.long
def test_command_line(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["no-such-study"])
    assert "no study no-such-study" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["table-1", "--runs", "0"])
    arguments = ["table-1", "table-2", "--runs", "1", "--workers", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    assert capsys.readouterr().out.count("# Report, Tables 1 and 2") == 1
    assert main([*arguments, "--seed", "1"]) == 2
    assert "--fresh" in capsys.readouterr().err
    for name in ("table-1", "table-2", "table-3", "table-4"):
        assert ALIASES[name] in STUDIES
    for name in ("table-I", "figure-1", "table-II", "poster-linear", "poster-nonlinear"):
        assert STUDIES[name].title
