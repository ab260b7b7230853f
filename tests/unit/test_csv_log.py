"""CSV recordings with a column map: values by hand, and every wrong map or file is one line that says what to do."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from mavdiag.errors import InputError
from mavdiag.logs import read_log
from mavdiag.logs.csv_columns import load_column_map, parse_column_map
from mavdiag.telemetry import Signal

MAP = """
[time]
column = "time"
unit = "ms"
[body_rate]
columns = ["p", "-q", "r"]
unit = "deg/s"
[actuator]
columns = ["m1", "m2"]
unit = "percent"
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "flight.csv"
    path.write_text(text)
    return path


def test_units_and_directions_become_si_and_frd(tmp_path: Path) -> None:
    path = written(tmp_path, "m2,time,p,q,r,m1\n40,1000,90,180,-90,10\n50,1010,0,0,0,20\n")
    log = read_log(path, columns=parse_column_map(MAP))
    np.testing.assert_allclose(log[Signal.BODY_RATE].values[0], [np.pi / 2, -np.pi, -np.pi / 2])
    assert log[Signal.BODY_RATE].t_ns.tolist() == [1_000_000_000, 1_010_000_000]
    np.testing.assert_allclose(log[Signal.ACTUATOR].values, [[0.1, 0.4], [0.2, 0.5]])
    assert (log.profile, log.notes) == ("csv", ())


def test_a_file_without_header_or_time_is_read_by_number_and_rate(tmp_path: Path) -> None:
    path = written(tmp_path, "comment\n1;2;3\n4;5;6\n7;8;9\n")
    text = '[time]\nrate_hz = 200\n[body_rate]\ncolumns = ["1", "2", "3"]\nunit = "rad/s"\n'
    log = read_log(path, columns=parse_column_map(text + '[file]\ndelimiter = ";"\nskip_lines = 1\nheader = false\n'))
    np.testing.assert_allclose(log[Signal.BODY_RATE].values, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    assert np.diff(log[Signal.BODY_RATE].t_ns).tolist() == [5_000_000, 5_000_000]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[time]\nrate_hz = 1\n", "body_rate is missing"),
        ('[body_rate]\ncolumns = ["p", "q", "r"]\nunit = "rad/s"\n', "give the column of the time, or rate_hz"),
        (MAP.replace('"ms"', '"h"'), "time: unit: input should be 's', 'ms', 'us' or 'ns'"),
        (MAP.replace("deg/s", "deg"), "body_rate.unit: 'deg' is none of"),
        (MAP.replace('"-q", ', ""), "body_rate.columns: it has 3 columns, not 2"),
        (MAP + "[speed]\ncolumns = ['v']\n", "speed: no such table"),
        (MAP.replace("[actuator]", "[actuator]\nscale = 2"), "scale: extra inputs are not permitted"),
        (MAP.replace("rate]", "rate"), "not TOML"),
    ],
)
def test_a_wrong_map_names_its_field(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        load_column_map(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a,b\n1,2\n", "no column 'time'; there are a, b"),
        ("time,p,q,r,m1,m2\n", "it has no rows"),
        ("time,p,q,r,m1,m2\nx,y,z,,,\n", "no row has a time"),
        ("time,p,q,r,m1,m2\n1,,,,1,1\n2,,,,1,1\n", "most rows have no gyro"),
        ("\x00\xff\n" * 10, "no column 'time'"),
    ],
)
def test_a_file_that_the_map_does_not_fit_is_one_line(content: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read_log(written(tmp_path, content), columns=parse_column_map(MAP))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "time,p,q,r,m1,m2\n" + "1" * 200_000 + ",0,0,0,0,0\n",
        "time,p,q,r,m1,m2\n0,0,0,0,0,0\n" + 'x"' * 70_000,
        'time,p,q,r,m1,m2\n0,0,"' + "1\n" * 140_000,
        "0," * 5_000_000,
    ],
)
def test_what_is_no_sound_csv_file_is_one_line(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, text)
    tracemalloc.start()
    with pytest.raises(InputError) as caught:
        read_log(path, columns=parse_column_map(MAP))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 4 * len(text) + 20_000_000
    assert "\n" not in str(caught.value)
