"""One file with several records, which a column tells apart."""

from __future__ import annotations

import numpy as np
import pytest

from engine.data.by_column import names_records, parts_of
from engine.data.csv_files import read_csv
from engine.data.series import Series
from engine.errors import ReadingWarning, SeriesError

RATS = """row,Rat,Diet,Time [d],weight
1,B,1,1,240
2,B,1,8,250
3,A,1,1,225
4,A,1,9.5,
5,A,1,15,230
6,B,1,15,255
"""


def written(tmp_path, text):
    path = tmp_path / "rats.csv"
    path.write_text(text)
    return path


def test_each_has_its_rows_and_its_clock(tmp_path):
    """In the order in which they first appear; rows of one need not stand together."""
    B, A = Series.read_records(written(tmp_path, RATS), by="Rat", y=["weight"])
    assert B.t.tolist() == [1.0, 8.0, 15.0]
    assert A.t.tolist() == [1.0, 9.5, 15.0]
    np.testing.assert_array_equal(A.y[:, 0], [225.0, np.nan, 230.0])
    assert A.time_unit == "day"


def test_dates_are_counted_from_the_first_of_each(tmp_path):
    text = "id,when,y\n" + "".join(
        f"{k},2024-03-{3 * k + day:02d},{day}\n" for k in (1, 2) for day in range(2)
    )
    one, other = Series.read_records(written(tmp_path, text), by="id", t="when", time_unit="day")
    assert one.t.tolist() == other.t.tolist() == [0.0, 1.0]


def test_several_columns_tell_together(tmp_path):
    text = "who,drug,t,y\n" + "".join(
        f"{who},{drug},{t},1\n" for who in "ab" for drug in "xy" for t in range(3)
    )
    assert len(Series.read_records(written(tmp_path, text), by=["who", "drug"])) == 4


def test_numbers_are_alike_however_they_are_written(tmp_path):
    text = "id,t,y\n1,0,1\n1.0,1,2\n01,2,3\n2,0,1\n2,1,1\n"
    assert [len(one) for one in Series.read_records(written(tmp_path, text), by="id")] == [3, 2]


def test_one_row_is_no_record_and_that_is_said(tmp_path):
    path = written(tmp_path, RATS + "7,C,2,1,300\n")
    with pytest.warns(ReadingWarning, match="left out, as they have one row: Rat C"):
        assert len(Series.read_records(path, by="Rat", y=["weight"])) == 2


@pytest.mark.parametrize(
    ("by", "text", "said"),
    [
        ("Mouse", RATS, r"rats.csv has no column 'Mouse' .*there are 'row', 'Rat'"),
        ("Rat", RATS.replace("4,A", "4,"), "column 'Rat' does not name the record at line 5"),
        ("row", RATS, "no record of column 'row' has two rows"),
        ("Diet", RATS, r"rats.csv, Diet 1: t decreases at line 4 .*If the column 'Rat' names"),
        ("Rat", RATS.replace("9.5", "0.5"), r"rats.csv, Rat A: t decreases at line 5 \(0.5\)"),
    ],
)
def test_what_is_wrong(by, text, said, tmp_path):
    with pytest.raises(SeriesError, match=said):
        Series.read_records(written(tmp_path, text), by=by, y=["weight"])


def test_a_column_is_pointed_out_where_times_fall_back(tmp_path):
    hint = r"t decreases at line 4 \(1\).*'Rat' names the records, say .*read_records\(\.\.\., by='Rat'\)"
    with pytest.raises(SeriesError, match=hint):
        Series.read(written(tmp_path, RATS), y=["weight"])


@pytest.mark.parametrize(
    "text",
    [
        "id,t,y\n1,0,1\n2,0,1\n3,1,2\n4,1,3\n",  # a row is no record
        "id,t,y\n1,0,1\n1,0,1\n2,0,2\n2,1,3\n",  # times repeat within it
        "id,t,y\n1,0,1\n,0,1\n1,1,2\n1,2,3\n",  # of one row it is not known
        "id,t,y\n1,2,1\n1,1,1\n1,0,2\n1,-1,3\n",  # all are of one
    ],
)
def test_no_column_is_pointed_out_by_which_times_would_not_increase(text):
    assert names_records(read_csv(text.encode(), "a.csv"), "t", ["y"]) == ""


def test_lines_are_those_of_the_file():
    parts = parts_of(read_csv(RATS.encode(), "a.csv"), ["Rat"])
    assert [list(part.lines) for part in parts] == [[2, 3, 7], [4, 5, 6]]


VISITS = "id,visit,y\n" + "".join(f"{who},{2 * k},1.5\n" for k in range(3) for who in "ab")


def test_times_that_nobody_calls_so_are_pointed_out_with_the_column_that_names_records(tmp_path):
    """Rows of several subjects in turn were one record, and its times the numbers of its rows."""
    with pytest.warns(ReadingWarning, match=r"by='id', t='visit'"):
        Series.read(written(tmp_path, VISITS), y="y")
    with pytest.warns(ReadingWarning, match="'visit' counts up evenly, give t='visit'"):
        Series.read_records(written(tmp_path, VISITS), by="id", y="y")
    one, _ = Series.read_records(written(tmp_path, VISITS), by="id", y="y", t="visit")
    assert one.t.tolist() == [0.0, 2.0, 4.0]
