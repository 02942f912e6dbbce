"""Files of oscilloscopes, cyclers and measurement programs, as these write them."""

import numpy as np
import pytest

from eoi_jax.data.column_names import short_names
from eoi_jax.data.inspection import inspect
from eoi_jax.data.readers.read_record import read_record, read_table

N = 300
PERIOD = 2e-6
T = np.round(PERIOD * np.arange(N) - 1e-4, 9)
U = 4.0 * np.sign(np.sin(0.3 * np.arange(N)))
Y = np.round(np.sin(0.05 * np.arange(N)), 6)

TEKTRONIX = """Model,MSO64B
Firmware Version,2.8.4

Waveform Type,ANALOG,,
Horizontal Units,s,,
Sample Interval,2e-06,,
Vertical Units,V,A,
Vertical Offset,0.0,0.0,
Vertical Scale,2.0,1.0,
{label}TIME,CH1,CH2
"""
SIGLENT = """Record Length,Analog:300
Sample Interval,Analog:2.00E-06
Vertical Units,CH1:V CH2:A
Horizontal Units,s
Source,CH1,CH2
Second,Volt,Ampere
"""
LECROY = """LECROYWS3024,00000,Waveform
Segments,1,SegmentSize,300
Segment,TrigTime,TimeSinceSegment1
#1,30-Nov-2026 09:12:11,0
Time,Ampl,Ampl2
"""
# By instrument: lines above the data, a line of data, names, units.
SCOPES = {
    "Rigol": (
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.000000e-04,2.000000e-06\n",
        "{k},{u:.3e},{y:.6e},", ("X", "CH1", "CH2"), ("s", "V", "V"),
    ),
    "Rigol, padded": (
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Ampere,-1.000000e-04,2.000000e-06\n",
        "{k},{u:.3e},{y:.6e},,", ("X", "CH1", "CH2"), ("s", "V", "A"),
    ),
    "Rigol, with stamps": (
        "X,CH1,CH2,\nSecond,Volt,Volt,\n", "{t:.5e},{u:.3e},{y:.6e},",
        ("X", "CH1", "CH2"), ("s", "V", "V"),
    ),
    "Tektronix MSO": (
        TEKTRONIX.format(label="Label,u_phase,i_phase\n"), "{t:.6e},{u:.5f},{y:.6f}",
        ("TIME", "CH1", "CH2"), ("s", "V", "A"),
    ),
    "Tektronix MSO without labels": (
        TEKTRONIX.format(label=""), "{t:.6e},{u:.5f},{y:.6f}",
        ("TIME", "CH1", "CH2"), ("s", "V", "A"),
    ),
    "Keysight": (
        "x-axis,1,2\nsecond,Volt,Volt\n", "{t:+.7E},{u:+.4E},{y:+.6E}",
        ("x-axis", "1", "2"), ("s", "V", "V"),
    ),
    "Siglent": (
        SIGLENT, "{t:.9f},{u:.5f},{y:.6f}", ("Source", "CH1", "CH2"), ("s", "V", "A"),
    ),
    "LeCroy": (LECROY, "{t:.7e},{u:.5f},{y:.6f}", ("Time", "Ampl", "Ampl2"), ("", "", "")),
}  # fmt: skip


def written(path, head, line, count=N):
    lines = (line.format(k=k, t=T[k], u=U[k], y=Y[k]) for k in range(count))
    path.write_text(head + "\n".join(lines) + "\n", "utf-8")
    return path


@pytest.mark.parametrize("scope", SCOPES)
def test_an_oscilloscope_is_read_with_its_channels_units_and_period(tmp_path, scope):
    head, line, names, units = SCOPES[scope]
    path = written(tmp_path / "scope.csv", head, line)
    table = read_table(path)
    assert tuple(table.columns) == names
    assert tuple(table.units.get(name, "") for name in names) == units
    for name, values in zip(names, (T, U, Y), strict=True):
        np.testing.assert_allclose(table.columns[name], values, rtol=0, atol=1e-12)
    assert inspect(path).clock.sample_period == pytest.approx(PERIOD)
    record = read_record(path, *names)
    assert record.sample_period == pytest.approx(PERIOD)
    time_is_made = "`X` counts the samples: read as -0.0001 + 2e-06 `X`, the time in seconds"
    for notes in (table.notes, record.notes):
        assert any(time_is_made in note for note in notes) == ("{k}" in line)
    labels = "Labels in the file: `CH1` is u_phase, `CH2` is i_phase."
    assert (labels in table.notes) == ("Label," in head)


def test_a_count_of_samples_with_words_stays_as_it_is(tmp_path):
    head, line, *_ = SCOPES["Rigol"]
    path = written(tmp_path / "scope.csv", head, line)
    path.write_text(path.read_text().replace("\n7,", "\ntrigger,"))
    assert read_table(path).columns["X"][8] == "8"


def test_settings_beside_the_data_are_no_header(tmp_path):
    """Tektronix TDS: no line of names, and settings in the first rows on the left."""
    settings = ["Record Length,3e+02", "Sample Interval,2e-06", "Trigger Point,50", ",", ",",
                "Source,CH1", "Vertical Units,V", "Model Number,TDS2014B"]  # fmt: skip
    lines = [
        f"{settings[k] if k < len(settings) else ','},,{T[k]:012.8f},{Y[k]:.6f}," for k in range(N)
    ]
    path = tmp_path / "scope.csv"
    path.write_text("\n".join(lines))
    table = read_table(path)
    assert list(table.columns) == ["3", "4"]
    np.testing.assert_allclose(table.columns["4"], Y, atol=1e-12)
    assert "There is no line of names: the columns are numbered from 0." in table.notes
    left_out = "Columns 0, 1, 2 hold settings of an instrument, no samples: left out."
    assert left_out in table.notes
    assert inspect(path).clock.column == "3"


YOKOGAWA = """"Model","DLM2054"
"BlockNumber",1
"TraceName","CH1","CH2"
"BlockSize",300,300
"VUnit","V","A"
"SampleRate",500000,500000
"HResolution",{period},{period}
"HOffset",-0.0001,-0.0001
"HUnit","{unit}","{unit}"

"""
LABVIEW = """LabVIEW Measurement\t
Separator\tTab
Decimal_Separator\t.
X_Columns\t{columns}
Date\t2026/11/30
Time\t08:00:01.1234
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t300\t300\t
Y_Unit_Label\tVolts\tAmps\t
X_Dimension\tTime\tTime\t
X0\t0.0\t0.0\t
Delta_X\t0.000002\t0.000002\t
***End_of_Header***\t\t\t
X_Value\tVoltage\tCurrent\tComment
"""


@pytest.mark.parametrize(
    ("name", "head", "line", "channels", "setting"),
    [
        ("y.csv", YOKOGAWA.format(period=2e-6, unit="s"), ",{u:.4E},{y:.6E}", ("CH1", "CH2"),
         "HResolution"),
        ("y.csv", YOKOGAWA.format(period=2e-3, unit="ms"), ",{u:.4E},{y:.6E}", ("CH1", "CH2"),
         "HResolution"),
        ("n.lvm", LABVIEW.format(columns="No"), "\t{u:.6f}\t{y:.6f}", ("Voltage", "Current"),
         "Delta_X"),
        ("n.lvm", LABVIEW.format(columns="One"), "{t:.9f}\t{u:.6f}\t{y:.6f}",
         ("Voltage", "Current"), ""),
    ],
)  # fmt: skip
def test_the_period_comes_from_the_settings_where_no_column_is_a_time(
    tmp_path, name, head, line, channels, setting
):
    path = written(tmp_path / name, head, line)
    table = read_table(path)
    assert tuple(table.columns)[1:] == channels
    assert [table.units[key] for key in channels] == ["V", "A"]
    np.testing.assert_allclose(table.columns[channels[1]], Y, atol=1e-12)
    clock = inspect(path).clock
    assert clock.sample_period == pytest.approx(PERIOD)
    assert clock.column == (None if setting else "X_Value")
    assert not setting or clock.why == f"`{setting}` is 2e-06"


def test_a_spectrum_has_no_period(tmp_path):
    path = written(tmp_path / "y.csv", YOKOGAWA.format(period=10, unit="Hz"), ",{u:.4E},{y:.6E}")
    assert inspect(path).clock.sample_period is None


def test_a_row_of_what_the_logger_did_stands_below_the_units(tmp_path):
    """A table of a Campbell Scientific logger, TOA5."""
    head = """"TOA5","CR1000","CR1000","1234"
"TIMESTAMP","RECORD","Batt","T_air"
"TS","RN","Volts","Deg C"
"","","Min","Avg"
"""
    path = written(tmp_path / "met.dat", head, '"2026-11-30 08:01:{k:02d}",{k},{u},{y}', 60)
    table = read_table(path)
    assert list(table.columns) == ["TIMESTAMP", "RECORD", "Batt", "T_air"]
    assert table.units == {"Batt": "V", "T_air": "°C"}
    assert inspect(path).clock.column == "TIMESTAMP"


EC_LAB = """EC-Lab ASCII FILE
Nb header lines : 6

Electrode connection : standard
Acquisition started on : 11/30/2026 08:11:02
mode\tox/red\ttime/s\tcontrol/V/mA\tEwe/V\tI/mA\tTemperature/°C\tdQ/mA.h/g\t
"""


def test_units_behind_slashes_are_no_part_of_the_names(tmp_path):
    path = tmp_path / "cell.mpt"
    line = "1\t0\t{0:.6E}\t{1:.6E}\t{2:.6E}\t{1:.6E}\t{2:.3E}\t{2:.3E}\n"
    lines = (line.format(k, U[k], Y[k]).replace(".", ",") for k in range(N))
    path.write_bytes((EC_LAB + "".join(lines)).encode("latin-1"))
    table = read_table(path)
    names = ["mode", "ox/red", "time", "control", "Ewe", "I", "Temperature", "dQ"]
    assert list(table.columns) == names == short_names(names)[:1] + names[1:]
    assert table.units == {
        "time": "s", "Ewe": "V", "I": "mA", "Temperature": "°C", "dQ": "mA.h/g",
    }  # fmt: skip
    said = "Units behind a slash are no part of the names: `time/s` is `time`, `control/V/mA` is"
    assert any(said in note for note in table.notes)
    assert len(read_record(path, "time", "I", "Ewe").time) == N
    with pytest.raises(ValueError, match=r"got `Ewe/V`\. Did you mean `Ewe`\?"):
        read_record(path, "time", "I", "Ewe/V")


@pytest.mark.parametrize("count", [30, 199, 400])
def test_a_long_header_is_as_long_as_the_file_says(tmp_path, count):
    settings = "".join(f"Ns  {k}  {0.5 * k:.3f}\n" for k in range(count))
    head = EC_LAB.replace("\n\n", f"\n\n{settings}").replace(": 6", f": {count + 6}")
    path = written(tmp_path / "cell.mpt", head, "\t".join(["1", "0", "{t}", *["{y}"] * 5]))
    table = read_table(path)
    assert list(table.columns)[2:5] == ["time", "control", "Ewe"]
    np.testing.assert_array_equal(table.columns["Ewe"], Y)
    assert f"Skipped before the header: {count + 4} lines." in table.notes
    path.write_text(path.read_text("utf-8").replace(f"\n1\t0\t{T[9]}", "\n1\t0\ttorn"), "utf-8")
    with pytest.raises(ValueError, match=rf"'torn' in line {count + 6 + 10}\."):
        read_record(path, "time", "I", "Ewe")


@pytest.mark.parametrize(
    "names",
    [
        ("t", "motor/V", "motor/A"),  # would be one
        ("t", "u", "dQ/dV"),
        ("t", "U/V", "y"),  # a single one may be a path
        ("t", "/arm/rad", "/arm/V"),
        ("t", "in/left", "in/right"),
    ],
)
def test_other_slashes_stay_in_the_names(tmp_path, names):
    path = written(tmp_path / "run.csv", ",".join(names) + "\n", "{t},{u},{y}")
    assert tuple(read_table(path).columns) == names
    assert not any("slash" in note for note in read_table(path).notes)


def test_a_row_of_settings_is_no_row_of_names_and_one_of_units_stays_one(tmp_path):
    path = written(tmp_path / "run.csv", "unit,flow,level\ns,V,rad\n", "{t},{u},{y}")
    assert read_table(path).units == {"unit": "s", "flow": "V", "level": "rad"}
    path = written(tmp_path / "run.csv", "Units,V,rad\ntime,flow,level\n", "{t},{u},{y}")
    assert read_table(path).units == {"flow": "V", "level": "rad"}
    assert list(read_table(path).columns) == ["time", "flow", "level"]
