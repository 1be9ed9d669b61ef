"""Files as laboratories write them: every format, every spreadsheet's habits, the real campaigns."""

from pathlib import Path

import numpy as np
import pytest
from builders.places import DATA

from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, check_campaign, read_at2, read_campaign, write_at2, write_campaign
from hsed_jax.measurements.records import read_columns

G = 9.80665
real = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured campaigns are not at {DATA}")

TIME = np.arange(6) * 0.5
ELONGATION = np.array([0.0, 1.25, -2.5, 3.0, 1e-3, -0.125])
FORCE = np.array([0.5, 10.0, -20.25, 30.0, 2.0, -1.5])

DECLARATION = """
name: test
protocol: displacement
channels:
  time: {column: t, unit: s}
  elongation: {column: du, unit: mm}
  force: {column: F, unit: kN}
"""


def folder_with(tmp_path: Path, record: str, content: str | bytes = b"", experiments: str | None = None) -> Path:
    (tmp_path / "records").mkdir(exist_ok=True)
    (tmp_path / "campaign.yaml").write_text(DECLARATION)
    (tmp_path / "experiments.csv").write_text(experiments or f"id,record\nE01,records/{record}\n")
    data = content.encode() if isinstance(content, str) else content
    if data:
        (tmp_path / "records" / record).write_bytes(data)
    return tmp_path


def check(campaign: Campaign) -> None:
    record = campaign["E01"].record
    assert record is not None
    np.testing.assert_array_equal(record.time, TIME)
    np.testing.assert_array_equal(record["elongation"], ELONGATION / 1000)
    np.testing.assert_array_equal(record["force"], FORCE * 1000)


def lines(separator: str, mark: str = ".", end: str = "\n", header: bool = True, tail: str = "") -> str:
    rows = [["t", "du", "F"]] if header else []
    rows += [[repr(float(v)).replace(".", mark) for v in row] for row in zip(TIME, ELONGATION, FORCE, strict=True)]
    return "".join(separator.join(row) + tail + end for row in rows)


TEXTS = {
    "comma": lines(","),
    "semicolon": lines(";"),
    "tab": lines("\t"),
    "blanks": lines("   "),
    "blanks before": "".join("  " + line + "\n" for line in lines("  ").splitlines()),
    "decimal comma": lines(";", ","),
    "decimal comma with tabs": lines("\t", ","),
    "blank after the comma": lines(", "),
    "windows": lines(",", end="\r\n"),
    "old mac": lines(",", end="\r"),
    "BOM": "\ufeff" + lines(","),
    "BOM and comments": "\ufeff# recorded by A, B\n% and C\n// and D\n" + lines(";"),
    "comments inside": lines(",").replace("1.0,", "# paused, at 5 o'clock\n1.0,", 1),
    "loud comments": "### test 3 ###\n##########\n" + lines(","),
    "blank lines": "\n\n" + lines(",") + "\n\n",
    "blank columns": lines(",", tail=",,"),
    "blank rows below": lines(",") + ",,\n,,\n",
    "quoted": lines('","').replace("\n", '"\n"').removesuffix('"').join(['"', ""]),
    "more columns": lines(",", tail=",text").replace("F,text", "F,note"),
    "index without a name": "".join(f"{'' if i == 0 else i},{row}\n" for i, row in enumerate(lines(",").splitlines())),
    "header in a comment": "# t du F\n" + lines(" ", header=False),
    "header in a comment, commas": "# t,du,F\n" + lines(",", header=False),
    "header padded": lines(",").replace("t,du,F", " t , du , F "),
    "separator named": "sep=;\n" + lines(";", ","),
    "no line end": lines(",").rstrip(),
    "exponents": lines(",").replace("0.001", "1E-3").replace("30.0", "+3.0D+01"),
    "latin": "# Prüfung in µm\n".encode("cp1252") + lines(",").encode(),
    "utf-16": lines("\t").encode("utf-16"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_text_records(tmp_path, case):
    check(read_campaign(folder_with(tmp_path, "E01.csv", TEXTS[case])))


@pytest.mark.parametrize("separator", [",", ";", " ", "\t"])
def test_columns_without_header_are_named_by_position(tmp_path, separator):
    folder = folder_with(tmp_path, "E01.txt", lines(separator, header=False))
    declaration = DECLARATION.replace("column: t,", "column: 1,").replace("du", "2").replace("F", "3")
    (folder / "campaign.yaml").write_text(declaration)
    campaign = read_campaign(folder)
    check(campaign)
    write_campaign(campaign, tmp_path / "again")  # with a header, in which a number would look like a sample
    assert read_campaign(tmp_path / "again") == campaign
    (folder / "campaign.yaml").write_text(DECLARATION)
    with pytest.raises(UserError, match="no header"):
        read_campaign(folder)


@pytest.mark.parametrize("name", ["du", "du mm", "du;mm", "du, mm"])
def test_a_record_of_one_column(tmp_path, name):
    quoted = f'"{name}"' if "," in name else name
    folder = folder_with(tmp_path, "E01.csv", "".join(f"{cell}\n" for cell in [quoted, *ELONGATION]))
    declaration = "name: a\nprotocol: displacement\nchannels:\n  elongation: {column: '" + name + "', unit: mm}\n"
    (folder / "campaign.yaml").write_text(declaration)
    np.testing.assert_array_equal(read_campaign(folder)["E01"].record["elongation"], ELONGATION / 1000)


def test_nan_is_read_and_left_to_the_checks(tmp_path):
    record = read_campaign(folder_with(tmp_path, "E01.csv", lines(",").replace("30.0", "NaN")))["E01"].record
    assert np.isnan(record["force"]).tolist() == [False, False, False, True, False, False]


def arrays() -> dict[str, np.ndarray]:
    return {"t": TIME, "du": ELONGATION, "F": FORCE}


def write_parquet(path, frame):
    import pandas as pd

    pd.DataFrame(frame).to_parquet(path)


def write_mat(path, frame):
    from scipy.io import savemat

    savemat(path, frame)


def write_hdf5(path, frame):
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in frame.items():
            file[name] = values


def write_mat_73(path, frame):
    """What MATLAB writes with -v7.3: HDF5 behind 512 bytes of its own, vectors as 1 × n."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in frame.items():
            file[name.replace(".", "/")] = np.atleast_2d(values)
    with Path(path).open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


WRITERS = {"E01.parquet": write_parquet, "E01.mat": write_mat, "E01.h5": write_hdf5, "E02.mat": write_mat_73}


@pytest.mark.parametrize("name", WRITERS)
def test_binary_records(tmp_path, name):
    folder = folder_with(tmp_path, name)
    path, write = tmp_path / "records" / name, WRITERS[name]
    write(path, arrays())
    check(read_campaign(folder))
    for broken, message in (
        ({"t": TIME, "du": ELONGATION}, "'F' is missing"),
        ({**arrays(), "F": np.array(["a"] * 6, dtype="S1")}, "'F'.*real numbers"),
    ):
        if name == "E02.mat" or "F" not in broken or write is not write_hdf5:
            write(path, broken)
            with pytest.raises(UserError, match=message):
                read_campaign(folder)
    if write is not write_parquet:
        write(path, {**arrays(), "F": FORCE[:-1]})
        with pytest.raises(UserError, match="differ in length"):
            read_campaign(folder)
    path.write_bytes(b"not such a file at all")
    with pytest.raises(UserError, match="cannot be read"):
        read_campaign(folder)


def test_scalars_for_channels_are_no_record(tmp_path):
    folder = folder_with(tmp_path, "E01.h5")
    write_hdf5(tmp_path / "records" / "E01.h5", {name: values[0] for name, values in arrays().items()})
    with pytest.raises(UserError, match=r"E01\.h5: .*at least two samples"):
        read_campaign(folder)


def test_an_array_beyond_the_budget_is_not_read(tmp_path):
    import h5py

    folder = folder_with(tmp_path, "E01.h5")
    with h5py.File(tmp_path / "records" / "E01.h5", "w") as file:
        for name in arrays():
            file.create_dataset(name, shape=(2_000_000_000,), dtype=float, chunks=(1024,))
    with pytest.raises(UserError, match=r"E01\.h5: 6,000,000,000 numbers are more than the allowed 12,000,000; thin"):
        read_campaign(folder)


@pytest.mark.parametrize("write", [write_mat, write_mat_73])
def test_matlab_structures(tmp_path, write):
    folder = folder_with(tmp_path, "E01.mat")
    (folder / "campaign.yaml").write_text(DECLARATION.replace("column: F", "column: load.F"))
    frame = {"t": TIME, "du": ELONGATION}
    nested = {"load": {"F": FORCE}} if write is write_mat else {"load.F": FORCE}
    write(tmp_path / "records" / "E01.mat", {**frame, **nested})
    check(read_campaign(folder))


MATRIX = DECLARATION.replace("column: t,", 'column: "log(:,1)",').replace("column: du", 'column: "log(:, 2)"')


@pytest.mark.parametrize("write", [write_mat, write_mat_73, write_hdf5])
def test_columns_and_rows_of_a_matrix(tmp_path, write):
    record = "E01.h5" if write is write_hdf5 else "E01.mat"
    folder, path = folder_with(tmp_path, record), tmp_path / "records" / record
    matrix = np.stack([TIME, ELONGATION, FORCE], axis=1)
    declare = (folder / "campaign.yaml").write_text
    # A matrix of MATLAB lies transposed in a v7.3 file.
    write(path, {"log": matrix.T if write is write_mat_73 else matrix})
    declare(MATRIX.replace("column: F", 'column: "log(:,3)"'))
    check(campaign := read_campaign(folder))
    write_campaign(campaign, tmp_path / "again")
    check(read_campaign(tmp_path / "again"))
    declare(MATRIX.replace("column: F", 'column: "log(:,4)"'))
    with pytest.raises(UserError, match=r"no log\(:,4\); 'log' has shape \(6, 3\)"):
        read_campaign(folder)
    declare(DECLARATION.replace("column: F", "column: log"))
    write(path, {"t": TIME, "du": ELONGATION, "log": matrix})
    with pytest.raises(UserError, match=r"one column of the matrix is log\(:,1\)"):
        read_campaign(folder)
    declare(DECLARATION.replace("column: F", 'column: "log(3,:)"'))
    write(path, {"t": TIME, "du": ELONGATION, "log": matrix if write is write_mat_73 else matrix.T})
    check(read_campaign(folder))


def test_records_are_found_by_id(tmp_path):
    check(read_campaign(folder_with(tmp_path, "E01.txt", lines(" "), "id\nE01\n")))


def test_dates_in_a_parquet_column_are_refused(tmp_path):
    folder = folder_with(tmp_path, "E01.parquet")
    write_parquet(tmp_path / "records" / "E01.parquet", {**arrays(), "t": TIME.astype("M8[s]")})
    with pytest.raises(UserError, match=r"'t'.*real numbers"):
        read_campaign(folder)


@pytest.mark.parametrize(
    "experiments",
    [
        "\ufeffid;record;from;Bemerkung\r\nE01;records/E01.csv;0,5;größer, schneller\r\n;;;\r\n",
        "id,record,from,Bemerkung\nE01,records/E01.csv,.5,\"größer, schneller\"\n\n",
        "# our tests\nid\trecord\tfrom\tBemerkung\nE01\trecords\\E01.csv\t0,5\tgrößer, schneller\t\t\n",
        "sep=;\nid;record;from;Bemerkung;;\nE01;records/E01.csv;5e-1;größer, schneller;;\n",
    ],
)  # fmt: skip
def test_experiments_as_spreadsheets_write_them(tmp_path, experiments):
    folder = folder_with(tmp_path, "E01.csv", lines(","))
    (folder / "experiments.csv").write_bytes(experiments.encode())
    campaign = read_campaign(folder)
    check(campaign)
    assert campaign["E01"].metadata == {"Bemerkung": "größer, schneller"}
    assert campaign["E01"].window == (0.5, 2.5)


def test_rows_without_time_are_their_own_time(tmp_path):
    folder = folder_with(tmp_path, "E01.csv", lines(","), "id,from,to\nE01,1,4\n")
    (folder / "campaign.yaml").write_text(DECLARATION.replace("  time: {column: t, unit: s}\n", ""))
    campaign = read_campaign(folder)
    assert not campaign.has_time
    np.testing.assert_array_equal(campaign["E01"].record.time, np.arange(6))
    assert campaign["E01"].in_window.sum() == 4


def test_pending_and_failed_experiments_need_no_record(tmp_path):
    experiments = "id,status,reason\nE01,,\nE02,Pending,\nE03,failed,actuator\nE04,abandoned,\n"
    campaign = read_campaign(folder_with(tmp_path, "E01.csv", lines(","), experiments))
    assert [e.status for e in campaign] == ["completed", "pending", "failed", "abandoned"]
    assert campaign["E03"].reason == "actuator"
    assert [e.id for e in campaign.completed] == ["E01"]


def motions(tmp_path: Path, quantities: bool = True) -> Path:
    declaration = "name: a\nprotocol: ground_motion\nchannels:\n  time: {unit: s}\n  ground_acceleration: {unit: g}\n"
    declaration += "  force: {unit: kN}\n" + (
        "quantities:\n  peak_force: {column: Fmax, unit: kN}\n" if quantities else ""
    )
    (tmp_path / "campaign.yaml").write_text(declaration)
    table = (
        "id,record,Fmax,status\nE01,E01.AT2,5,\nE02,E01.AT2,,pending\n" if quantities else "id,record\nE01,E01.AT2\n"
    )
    (tmp_path / "experiments.csv").write_text(table)
    write_at2(tmp_path / "E01.AT2", 0.02, [0.0, 1.0, -2.0])
    return tmp_path


def test_ground_motions_as_records(tmp_path):
    campaign = read_campaign(motions(tmp_path))
    for experiment in campaign:
        assert list(experiment.record.channels) == ["ground_acceleration"]
        np.testing.assert_allclose(experiment.record["ground_acceleration"], [0.0, 1.0, -2.0], rtol=1e-7)
        np.testing.assert_allclose(experiment.record.time, [0.0, 0.02, 0.04])
    write_campaign(campaign, tmp_path / "again")
    assert read_campaign(tmp_path / "again") == campaign


def test_a_ground_motion_is_no_measurement(tmp_path):
    with pytest.raises(UserError, match=r"\.AT2 file has no force"):
        read_campaign(motions(tmp_path, quantities=False))
    folder = folder_with(tmp_path / "b" if (tmp_path / "b").mkdir() is None else tmp_path, "E01.AT2", "x")
    with pytest.raises(UserError, match="protocol ground_motion"):
        read_campaign(folder)


AT2 = "PEER\nsomewhere\nACCELERATION TIME SERIES IN UNITS OF G\n"
HEADERS = {
    "new": "NPTS=  5, DT= .0100 SEC\n",
    "poles": "NPTS=   5, DT=   .0100 SEC,   4 POLE @    40.00000 HZ,  -5 POLE @      .20000\n",
    "lower": "npts =5 , dt = 1.0E-02 sec\n",
    "old": "    5    0.0100    NPTS, DT\n",
}


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize(
    "body",
    [
        "-.4981725E-02-.4964618E-02 .1E+01\n  .25\n0.\n",
        "  -4.981725E-03  -4.964618E-03\r\n1.0 0.25000-0.00000   ",
    ],
)
def test_at2_variants(tmp_path, header, body):
    path = tmp_path / "a.AT2"
    path.write_bytes((AT2 + HEADERS[header] + body).encode())
    dt, acceleration = read_at2(path)
    assert dt == 0.01
    np.testing.assert_allclose(acceleration / G, [-0.004981725, -0.004964618, 1.0, 0.25, 0.0], rtol=1e-14)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "empty"),
        ("a\nb\n1 2 3\n", "NPTS= and DT="),
        (AT2 + "NPTS= 3, DT= .01\n1 2\n", "2 samples.*NPTS=3"),
        (AT2 + "NPTS= 1, DT= .01\n1 2\n", "2 samples.*NPTS=1"),
        (AT2 + "NPTS= 0, DT= .01\n", "0 samples"),
        (AT2 + f"NPTS= {'9' * 5000}, DT= .01\n1 2 3\n", "row 4: NPTS is a number of 5000 digits"),
        (AT2 + "NPTS= 3, DT= 1e400\n1 2 3\n", "row 4: DT is inf"),
        (AT2 + "NPTS= 3, DT= .01\n1 1e400 3\n", "row 5: '1e400' g is out of range"),
        (AT2 + "NPTS= 3, DT= 0.0\n1 2 3\n", "row 4: DT"),
        (AT2 + "NPTS= 3, DT= .01\n1 2\nend 3\n", "row 6: 'end 3'"),
        (AT2 + "NPTS= 3, DT= .01\n1 2 0.006300.00364\n", "row 5"),
        (AT2 + "NPTS= 3, DT= .01\n1 2 nan\n", "row 5: 'nan'"),
        (AT2.replace(" G\n", " CM/S\n") + "NPTS= 3, DT= .01\n1 2 3\n", "units of CM/S"),
    ],
)
def test_at2_that_is_broken_is_refused(tmp_path, text, message):
    path = tmp_path / "a.AT2"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as error:
        read_at2(path)
    assert "a.AT2" in str(error.value)


def test_at2_round_trip(tmp_path):
    values = np.random.default_rng(0).normal(size=103)
    write_at2(tmp_path / "a.AT2", 0.005, values, "El Centro, 1940")
    dt, read = read_at2(tmp_path / "a.AT2")
    assert dt == 0.005
    np.testing.assert_allclose(read, values, rtol=1e-7)
    with pytest.raises(UserError, match="cannot be read"):
        read_at2(tmp_path / "b.AT2")


@real
@pytest.mark.parametrize(
    "name, peak",
    [
        ("Rinaldi228", 0.87),
        ("RSN77_SFERN_PUL164", 1.22),
        ("RSN1084_NORTHR_SCS052", 0.62),
        ("RSN181_IMPVALL.H_H-E06230", 0.45),
        ("elCentro", 0.32),
    ],
)
def test_recorded_ground_motions(name, peak):
    dt, acceleration = read_at2(DATA / "ground_motions" / f"{name}.AT2")
    assert dt in (0.005, 0.01, 0.02)
    assert round(np.abs(acceleration).max() / G, 2) == peak


@real
@pytest.mark.parametrize(
    "name, samples, elongation, force",
    [
        ("friction_damper", [3585, 3418, 3588], 1.5077, 4.9624),
        ("rc_column", [548, 548], 78.448, 199.59),
        ("steel_damper", [308, 308], 2.8775, 5.3117),
        ("timber_connection", [2822, 2822], 135.2829, 67.10382),
    ],
)
def test_measured_campaigns(tmp_path, name, samples, elongation, force):
    campaign = read_campaign(DATA / name)
    assert [len(e.record) for e in campaign] == samples
    record = campaign.experiments[0].record
    for channel, peak in (("elongation", elongation), ("force", force)):
        scale = 1000.0 if name == "rc_column" and channel == "elongation" else 1.0
        shown = campaign.unit(channel).from_si(np.abs(record[channel]).max()) * scale
        np.testing.assert_allclose(shown, peak, rtol=1e-4)
    assert len(campaign.train) and len(campaign.test)
    write_campaign(campaign, tmp_path)
    assert read_campaign(tmp_path) == campaign


# Thousands separators.

AMBIGUOUS = {
    "tab and comma": "t\tF\n0\t964\n1\t1,288\n2\t2,001\n",
    "semicolon and comma": "t;F\n0;964\n1;1,288\n",
    "semicolon and point": "t;F\n0;964\n1;1.288\n",
    "tab and point": "t\tF\n0\t-964\n1\t-1.288\n",
    "every number": "t;F\n1,288;1,288\n2,001;2,002\n",
    "another column with another mark": "t;F\n0,5;964\n1,5;1.288\n",
}
DECIMAL = {
    "less than one": ("t;F\n0;0,964\n1;1,288\n", [0.964, 1.288]),
    "two decimals": ("t;F\n0;9,64\n1;1,288\n", [9.64, 1.288]),
    "four digits before": ("t;F\n0;9640,125\n1;1,288\n", [9640.125, 1.288]),
    "an exponent": ("t;F\n0;9,640e2\n1;1,288\n", [964, 1.288]),
    "another column": ("t;F;u\n0;964;0,01\n1;1,288;0,02\n", [964, 1.288]),
    "a column that nobody asked for": ("t\tF\tu\n0\t964\t0.01\n1\t1.288\t0.02\n", [964, 1.288]),
    "commas between the columns": ("t,F\n0,964\n1,1.288\n", [964, 1.288]),
}


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_what_may_be_thousands_is_not_read_as_decimals(tmp_path, case):
    (tmp_path / "a.csv").write_text(AMBIGUOUS[case])
    with pytest.raises(
        UserError, match=r"row \d, column '[tF]': '-?1[.,]288' is -?1\.288 with a decimal (comma|point) and -?1288"
    ):
        read_columns(tmp_path / "a.csv", ["F"] if "another column" in case else ["t", "F"])


@pytest.mark.parametrize("case", DECIMAL)
def test_three_decimals_are_read_where_a_number_of_the_file_tells(tmp_path, case):
    text, expected = DECIMAL[case]
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_array_equal(read_columns(tmp_path / "a.csv", ["F"])["F"], expected)


def test_a_table_of_experiments_with_thousands_is_refused(tmp_path):
    (tmp_path / "campaign.yaml").write_text(
        "name: x\nprotocol: displacement\nquantities: {peak_force: {column: Fmax, unit: N}}\n"
    )
    (tmp_path / "experiments.csv").write_text("id;Fmax\nE01;964\nE02;1,288\n")
    with pytest.raises(
        UserError, match=r"experiments\.csv, row 3, column 'Fmax': '1,288' is 1\.288 with a decimal comma"
    ):
        read_campaign(tmp_path)


# --- titles above the names of a declared record, units below them ---------------------------------------------------

CHANNELS = "channels: {elongation: {column: U, unit: mm}, force: {column: F, unit: kN}}"
ROWS = "".join(f"{u},{f}\n" for u, f in ((0.0, 0.0), (1.5, 3.0), (-2.25, -4.5)))
BELOW_TITLES = {
    "titles": "Test unit,C2\nReference,L et al. (2014)\nU,F\n" + ROWS,
    "titles and units": "Test unit,C2\n\nReference,L\nU,F\n[mm],[kN]\n" + ROWS,
    "units in other words": "U,F\n(millimetres),KN\n" + ROWS,
    "a unit of one column": "U,F\n,kN\n" + ROWS,
    "an empty row above the numbers": "U,F\nmm,kN\n,\n\n" + ROWS,
    "one word, quotes": '"Wall, 3"\n"U","F"\n"(mm)","(kN)"\n' + ROWS,
    "semicolons, decimal comma": "Wall 3; L\nU;F\nmm;kN\n" + ROWS.replace(",", ";").replace(".", ","),
    "a column more, tabs": "Sample rate: 10 Hz\nt\tU\tF\nSec\tmm\tkN\n"
    + "".join(f"{k}\t{line}\n".replace(",", "\t") for k, line in enumerate(ROWS.splitlines())),
    "a comment among the titles": "Wall 3\n# of May\nU,F\n" + ROWS,
}


def declared(folder, content, channels=CHANNELS):
    (folder / "records").mkdir(exist_ok=True)
    (folder / "campaign.yaml").write_text(f"name: x\nprotocol: displacement\n{channels}\n")
    (folder / "experiments.csv").write_text("id\nE01\n")
    (folder / "records" / "E01.csv").write_text(content)
    return read_campaign(folder)["E01"].record


@pytest.mark.parametrize("case", BELOW_TITLES)
def test_a_declared_record_may_have_titles_and_units(tmp_path, case):
    record = declared(tmp_path, BELOW_TITLES[case])
    np.testing.assert_allclose(record["elongation"], [0, 1.5e-3, -2.25e-3])
    np.testing.assert_allclose(record["force"], [0, 3e3, -4.5e3])


def test_titles_above_numbers_without_names_are_told_from_a_header(tmp_path):
    by_position = CHANNELS.replace("column: U", "column: '1'").replace("column: F", "column: '2'")
    record = declared(tmp_path, "Test of a wall\nL\n" + ROWS, by_position)
    np.testing.assert_allclose(record["force"], [0, 3e3, -4.5e3])
    with pytest.raises(UserError, match=r"column '1' is missing; the columns are 'U', 'F' \(the file has a header"):
        declared(tmp_path, "U,F\n" + ROWS, by_position)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "Wall\nU,F\n[cm],[kN]\n" + ROWS,
            "column 'U': its row of units says 'cm', the campaign declares the unit 'mm'",
        ),
        ("U,F\nmm,mV\n" + ROWS, "column 'F': its row of units says 'mV', the campaign declares the unit 'kN'"),
        ("1,2\n3,4\nU,F\n" + ROWS, "row 1: a row of numbers stands above the names of the columns in row 3"),
        ("Wall\nU [mm],F [kN]\n" + ROWS, "column 'F' is missing; the columns are 'U .mm.', 'F .kN.'"),
        ("U [mm],F [kN]\n" + ROWS, "column 'F' is missing; the columns are 'U .mm.', 'F .kN.'"),
        ("Wall 3\na,b\n" + ROWS, "column 'F' is missing; the columns are 'a', 'b'"),
        ("Wall\nU,F\nmm,kN\n---,---\n" + ROWS, "row 4, column 'U': '---' is not a number"),
        ("Wall\nU,F\n" + ROWS + "U,F\n" + ROWS, "row 6, column 'U': 'U' is not a number"),
    ],
)
def test_what_a_declaration_and_its_file_do_not_agree_on_is_one_message(tmp_path, content, message):
    with pytest.raises(UserError, match=message):
        declared(tmp_path, content)


def test_rows_without_numbers_at_an_end_are_an_error_that_says_what_to_do(tmp_path):
    record = declared(tmp_path, "Wall\nU,F\nmm,kN\nNaN,1\nNaN,2\n" + ROWS * 4)
    assert np.isnan(record["elongation"][:2]).all()
    said = [finding.message for finding in check_campaign(read_campaign(tmp_path)) if finding.channel == "elongation"]
    assert said == [
        "2 of 14 samples are not numbers, the first is sample 1; all of them are at an end of the record: delete these rows, or "
        "have hsed init read the file"
    ]
