"""One file with the records of several subjects on the command line."""

import pytest

import engine

TEXT = """Subject,time [year],flow
x,1,1010
y,1,990
x,2.5,1020
x,4,1000
y,3,1040
y,4,1030
y,4.5,1010
"""
FIT = (
    "fit",
    "flows.csv",
    "-m",
    "local-level",
    "--method",
    "rts-em",
    "-n",
    1,
    "--no-standard-errors",
)


def test_a_column_names_the_records(rbps, tmp_path):
    path = tmp_path / "flows.csv"
    path.write_text(TEXT)
    found = rbps(*FIT, "--by", "Subject", "--json")
    assert found.exit_code == 0, found.stderr
    document = found.json()
    note = "flows.csv: 2 records, counted from 0 as Subject x; Subject y."
    assert note in document["notes"]
    records = engine.Series.read_records(path, by="Subject", y=["flow"])
    same = engine.rts_em(engine.get_model("local-level"), records, n_iterations=1)
    values = {name: one["value"] for name, one in document["estimate"].items()}
    assert values == pytest.approx(same.theta.asdict())
    said = rbps(*FIT, "--by", "Subject").stderr
    assert "flows.csv: 7 samples in 2 records at irregular times; flow" in said


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((), "If the column 'Subject' names the records, say --by 'Subject'"),
        (("--by", "Patient"), "--by Patient: flows.csv has no column 'Patient'"),
        (("--by", "time"), "flows.csv: no record of column 'time [year]' has two rows"),
    ],
)
def test_what_is_wrong(given, said, rbps, tmp_path):
    (tmp_path / "flows.csv").write_text(TEXT.replace("y,1,", "y,1.1,").replace("y,4,", "y,4.1,"))
    found = rbps(*FIT, *given)
    assert found.exit_code == 2
    assert said in found.stderr


def test_times_and_the_column_that_names_records_are_pointed_out_together(rbps, tmp_path):
    text = TEXT.replace("time [year]", "visit").replace("y,4,", "y,4.2,")
    (tmp_path / "flows.csv").write_text(text)
    both = (
        "as 'visit' rises in each record if 'Subject' names them, --by 'Subject' and --time 'visit'"
    )
    assert both in rbps(*FIT).stderr
    assert "as 'visit' counts up evenly, --time 'visit'" in rbps(*FIT, "--by", "Subject").stderr
