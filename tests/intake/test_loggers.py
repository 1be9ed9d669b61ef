"""Files as named loggers and spreadsheets write them, their numbers known: read right, or asked, never wrong."""

# ruff: noqa: E501  # a row of a table of files is a line

import io
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from builders.places import SHARED
from numpy.testing import assert_allclose

from hsed_jax.errors import UserError
from hsed_jax.intake.beginning import Said, begun

# What was measured: time [s], elongation [mm], force [kN], of 48 samples.
T = 0.1 * np.arange(48)
U = np.round(0.25 * np.arange(48) * np.sin(0.5 * np.arange(48)) + 0.013, 3)
F = np.round(40 * np.tanh(U / 5) + 0.7 * U + 0.25, 2)
DRIFT = np.round(U / 25, 4)


def rows(*columns, separator=",", mark=".", digits=None, end="\n", close=""):
    """Lines of numbers; `digits` of each column, or the shortest that says it."""
    given = digits or [None] * len(columns)

    def cell(value, count):
        text = f"{float(value):.10g}" if count is None else f"{float(value):.{count}f}"
        return text.replace(".", mark)

    body = [
        separator.join(cell(v, d) for v, d in zip(row, given, strict=True)) + close
        for row in zip(*columns, strict=True)
    ]
    return end.join(body) + end


def text(*lines, end="\n"):
    return end.join(lines) + end


def xlsx(*sheets, hidden=()):
    """A workbook of (title, rows)."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, cells in sheets:
        sheet = book.create_sheet(title)
        for row in cells:
            sheet.append(list(row))
        if title in hidden:
            sheet.sheet_state = "hidden"
    buffer = io.BytesIO()
    book.save(buffer)
    return buffer.getvalue()


def table(*columns):
    return [[float(v) for v in row] for row in zip(*columns, strict=True)]


STAMPS = [datetime(2024, 5, 1, 9, 30) + timedelta(seconds=float(t)) for t in T]
ALL, PAIR = "time elongation force", "elongation force"

LVM = text(
    "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t{mark}", "Multi_Headings\tNo",
    "X_Columns\t{x}", "Time_Pref\tRelative", "Operator\tlab", "Date\t2023/03/07", "Time\t10:14:12,6", "***End_of_Header***\t", "\t",
    "Channels\t2\t\t", "Samples\t48\t48\t", "Date\t2023/03/07\t2023/03/07\t", "Time\t10:14:12,6\t10:14:12,6\t", "Y_Unit_Label\tmm\tkN\t",
    "X_Dimension\tTime\tTime\t", "X0\t0{mark}0E+0\t0{mark}0E+0\t", "Delta_X\t0{mark}100000\t0{mark}100000\t", "***End_of_Header***\t\t\t",
    end="\r\n",
)  # fmt: skip


def arrays(ending, **columns):
    """A binary file of arrays by name; matrices and rows as they are."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a.{ending}"
        if ending == "npz":
            np.savez(path, **columns)
        elif ending == "mat":
            from scipy.io import savemat

            savemat(path, columns)
        elif ending == "parquet":
            import pandas as pd

            pd.DataFrame(columns).to_parquet(path)
        elif ending == "tdms":
            nptdms = pytest.importorskip("nptdms")
            units = {"Displacement": "mm", "Force": "kN"}
            with nptdms.TdmsWriter(path) as writer:
                writer.write_segment([
                    nptdms.ChannelObject("Log", name, values, {"unit_string": units[name], "wf_increment": 0.1})
                    for name, values in columns.items()
                ])  # fmt: skip
        else:
            import h5py

            with h5py.File(path, "w") as file:
                for name, values in columns.items():
                    file[f"test/{name}"] = values
                    file[f"test/{name}"].attrs["units"] = {"time": "s", "force": "kN"}.get(name, "mm")
        return path.read_bytes()


# Name of the file, its content, and the channels that are read; or what is asked.
READ = {
    "MTS TestSuite, tabs, units in a row": ("a.txt", text(
        "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A", "", "Data Acquisition: Timed\tTime: 41.2 Sec\t5/1/2024 9:30:00 AM",
        "Running Time\tActuator Displacement\tActuator Force", "Sec\tmm\tkN") + rows(T, U, F, separator="\t"), ALL),
    "MTS FlexTest, header again in the middle": ("a.dat", text("Time\tDisplacement\tForce", "s\tmm\tkN")
        + rows(T[:20], U[:20], F[:20], separator="\t") + text("", "Data Acquisition: Cyclic", "Time\tDisplacement\tForce", "s\tmm\tkN")
        + rows(T[20:], U[20:], F[20:], separator="\t"), ALL),
    "Instron Bluehill, quotes and brackets": ("a.csv", text('"Results Table 1"', "", '"Time","Extension","Load"', '"(s)","(mm)","(kN)"')
        + rows(T, U, F), ALL),
    "Instron WaveMatrix, columns that are no channel": ("a.csv", text(
        "Total Time (s),Total Cycles,Elapsed Cycles,Step,Position(Linear:Position) (mm),Load(Linear:Load) (kN)")
        + rows(T, 0 * T, 0 * T, 0 * T + 1, U, F), ALL),
    "LabVIEW lvm, one X column": ("a.lvm", LVM.format(mark=".", x="One") + text("X_Value\tWeg\tKraft\tComment", end="\r\n")
        + rows(T, U, F, separator="\t", digits=[6, 6, 6], end="\r\n"), ALL),
    "LabVIEW lvm, decimal comma": ("a.lvm", LVM.format(mark=",", x="One") + text("X_Value\tWeg\tKraft\tComment", end="\r\n")
        + rows(T, U, F, separator="\t", mark=",", digits=[6, 6, 6], end="\r\n"), ALL),
    "LabVIEW lvm, no X column": ("a.lvm", LVM.format(mark=".", x="No") + text("X_Value\tDisplacement\tForce\tComment", end="\r\n")
        + "".join("\t" + line + "\r\n" for line in rows(U, F, separator="\t", digits=[6, 6]).splitlines()), ALL),
    "LabVIEW lvm, an X column for each": ("a.lvm", LVM.format(mark=".", x="Multi")
        + text("X_Value\tDisplacement\tX_Value\tForce\tComment", end="\r\n")
        + rows(T, U, T, F, separator="\t", digits=[6, 6, 6, 6], end="\r\n"), ALL),
    "HBM catman, German": ("a.asc", (text("Messdaten catman", "Datum: 01.05.2024", "",
        "Zeit  1 - Standardmessrate\tWegaufnehmer\tKraftmessdose", "s\tmm\tkN") + rows(T, U, F, separator="\t", mark=",")
        ).encode("cp1252"), ALL),
    "HBM QuantumX export, semicolons": ("a.csv", text("Time [s];WA1 Displacement [mm];C2 Force [kN]") + rows(T, U, F, separator=";"), ALL),
    "Gantner test.commander, times of day": ("a.csv", text("Timestamp;Weg [mm];Kraft [kN]") + "".join(
        f"{stamp.isoformat(sep=' ', timespec='milliseconds')};{u};{f}\n" for stamp, u, f in zip(STAMPS, U, F, strict=True)), ALL),
    "Campbell TOA5": ("a.dat", text('"TOA5","station","CR1000X","1234","os","prog","77","fast"', '"TIMESTAMP","RECORD","Disp_LVDT","Load"',
        '"TS","RN","mm","kN"', '"","","Smp","Smp"') + "".join(f'"{stamp.isoformat(sep=" ", timespec="milliseconds")}",{k},{u},{f}\n'
        for k, (stamp, u, f) in enumerate(zip(STAMPS, U, F, strict=True))), ALL),
    "DEWESoft, facts above, units in brackets": ("a.txt", text("Data file: wall.dxd", "Start time: 5/1/2024 9:30:00.000",
        "Sample rate: 10 Hz", "Number of channels: 2", "", "Time (s)\tDisplacement (mm)\tForce (kN)") + rows(T, U, F, separator="\t"), ALL),
    "Zwick testXpert, quotes and decimal commas": ("a.TRA", text('"Prüfzeit";"Standardweg";"Standardkraft"', '"s";"mm";"N"').encode("cp1252")
        + rows(T, U, np.round(F * 1000), separator=";", mark=",").encode(), ALL),
    "NI DIAdem csv, UTF-8 with a mark": ("a.csv", b"\xef\xbb\xbf" + (text("Zeit in s;Weg in mm;Kraft in kN")
        + rows(T, U, F, separator=";", mark=",")).encode(), ALL),
    "Excel's Unicode text, UTF-16": ("a.txt", (text("Time [s]\tDisplacement [mm]\tForce [kN]") + rows(T, U, F, separator="\t")
        ).encode("utf-16"), ALL),
    "UTF-16 without a mark": ("a.csv", (text("Time [s],Displacement [mm],Force [kN]") + rows(T, U, F)).encode("utf-16-le"), ALL),
    "Japanese, Shift-JIS": ("a.csv", (text("試験体,No.3", "時間[s],変位[mm],荷重[kN]") + rows(T, U, F)).encode("cp932"), ALL),
    "Japanese, UTF-8, units in a row": ("a.csv", (text("時間,変位,荷重", "s,mm,kN") + rows(T, U, F)).encode(), ALL),
    "German Excel csv, sep=": ("a.csv", (text("sep=;", "Zeit [s];Verschiebung [mm];Horizontalkraft [kN]")
        + rows(T, U, F, separator=";", mark=",")).encode("cp1252"), ALL),
    "Italian": ("a.csv", text("Tempo [s];Spostamento [mm];Forza [kN]") + rows(T, U, F, separator=";", mark=","), ALL),
    "French, latin-1": ("a.csv", (text("Temps (s);Déplacement (mm);Force appliquée (kN)") + rows(T, U, F, separator=";", mark=",")
        ).encode("latin-1"), ALL),
    "Spanish": ("a.txt", (text("Tiempo [s]\tDesplazamiento [mm]\tCarga [kN]") + rows(T, U, F, separator="\t", mark=",")).encode(), ALL),
    "Portuguese, latin-1": ("a.txt", (text("Tempo (s)\tDeslocamento (mm)\tForça (kN)") + rows(T, U, F, separator="\t", mark=",")
        ).encode("latin-1"), ALL),
    "units behind a comma, tabs": ("a.txt", text("Time, s\tDisplacement, mm\tLoad, kN") + rows(T, U, F, separator="\t"), ALL),
    "units behind a comma, commas": ("a.csv", text("Time, s, Displacement, mm, Load, kN") + rows(T, U, F), ALL),
    "units behind a slash, DIN": ("a.txt", text("t/s\tWeg/mm\tKraft/kN") + rows(T, U, F, separator="\t"), ALL),
    "units as the last word": ("a.csv", text("time_s,disp_mm,load_kN") + rows(T, U, F), ALL),
    "fixed width, units in brackets": ("a.prn", text("   Time [s]   Disp [mm]  Force [kN]") + "".join(
        f"{t:11.3f}{u:12.3f}{f:12.3f}\n" for t, u, f in zip(T, U, F, strict=True)), ALL),
    "numpy.savetxt, header in a comment": ("a.txt", text("# time[s] disp[mm] force[kN]") + rows(T, U, F, separator=" "), ALL),
    "comments of MATLAB, tabs": ("a.dat", text("% specimen 3", "% Time [s]\tDisplacement [mm]\tForce [kN]") + rows(T, U, F, separator="\t"),
        ALL),
    "a published wall, titles with a comma": ("a.csv", text("Test unit,C2", "Reference,Silva et al. (2014)",
        "top_displacement,horizontal_force,drift", "[mm],[kN],[%]") + rows(U, F, DRIFT), PAIR),
    "dozens of rows of NaN first": ("a.csv", text("top_displacement,horizontal_force", "[mm],[kN]")
        + "".join(f"NaN,{f}\n" for f in np.linspace(-1, 1, 30)) + rows(U, F), PAIR),
    "rows of NaN between half-cycles": ("a.csv", text("disp [mm],force [kN]") + rows(U[:20], F[:20]) + "NaN,NaN\n" + rows(U[20:], F[20:]),
        PAIR),
    "pandas to_csv with an index": ("a.csv", text(",Displacement [mm],Force [kN]") + rows(np.arange(48), U, F), PAIR),
    "US units": ("a.csv", text("Time (sec),Disp (in),Load (kips)") + rows(T, U / 25.4, F / 4.4482216152605, digits=[3, 9, 9]), ALL),
    "a footer of text": ("a.csv", text("Time [s];Weg [mm];Kraft [kN]") + rows(T, U, F, separator=";") + "Ende der Messung\n", ALL),
    "a footer with the largest values": ("a.csv", text("Time [s],Disp [mm],Load [kN]") + rows(T, U, F) + "Max,11.2,43.1\n", ALL),
    "an empty third column, CR LF": ("a.csv", text("Disp [mm],Load [kN],", end="\r\n") + rows(U, F, close=",", end="\r\n"), PAIR),
    "command beside feedback": ("a.txt", text("Time [s]\tDisplacement command [mm]\tDisplacement feedback [mm]\tForce [kN]")
        + rows(T, U + 0.5, U, F, separator="\t"), ALL),
    "an actuator, told by its units": ("a.csv", text("Actuator [mm],Actuator [kN]") + rows(U, F), PAIR),
    "channels told by their units alone": ("a.csv", text("s,CH1 [mm],CH2 [kN]") + rows(T, U, F), ALL),
    "scientific notation with D, Fortran": ("a.out", text("time[s] disp[mm] force[kN]") + "".join(
        f"{t:.6E} {u:.6E} {f:.6E}\n".replace("E", "D") for t, u, f in zip(T, U, F, strict=True)), ALL),
    "a single column for each channel in rows": ("a.csv", text("Displacement [mm]," + ",".join(map(str, U)), "Force [kN],"
        + ",".join(map(str, F))), PAIR),
    "millivolts beside": ("a.csv", text("Time [s],LVDT [mm],Load cell [kN],Excitation [mV]") + rows(T, U, F, 0 * T + 5000), ALL),
    "a second time of the same numbers": ("a.csv", text("Time [s],Disp [mm],Time [s],Force [kN]") + rows(T, U, T, F), ALL),
    "Excel with titles, units in a row, a hidden sheet": ("a.xlsx", lambda: xlsx(
        ("data", [["Wall 3, May 2024"], ["Laboratory", "L1"], [], ["Time", "Displacement", "Force"], ["s", "mm", "kN"], *table(T, U, F)]),
        ("raw", [["Time [s]", "Displacement [mm]", "Force [kN]"], *table(T, 2 * U, F)]), hidden=("raw",)), ALL),
    "Excel with dates, a sheet of notes, a footer": ("a.xlsx", lambda: xlsx(
        ("data", [["Date", "Disp [mm]", "Load [kN]"], *([s, float(u), float(f)] for s, u, f in zip(STAMPS, U, F, strict=True)),
                  ["max", float(U.max()), float(F.max())]]),
        ("notes", [["tested by", "somebody"]])), ALL),
    "Excel, the table begins in column C": ("a.xlsx", lambda: xlsx(
        ("data", [[None, None, "Disp [mm]", "Load [kN]"], *([None, None, *row] for row in table(U, F))])), PAIR),
    "TDMS with units and a time step": ("a.tdms", lambda: arrays("tdms", Displacement=U, Force=F), ALL),
    "MATLAB, row vectors": ("a.mat", lambda: arrays("mat", time_s=T[None], disp_mm=U[None], force_kN=F[None]), ALL),
    "MATLAB, a structure": ("a.mat", lambda: arrays("mat", test={"time_s": T, "disp_mm": U, "force_kN": F, "rate": 10.0}), ALL),
    "NumPy, row vectors": ("a.npz", lambda: arrays("npz", time_s=T, disp_mm=U, load_kN=F), ALL),
    "Parquet": ("a.parquet", lambda: arrays("parquet", **{"Time [s]": T, "Disp [mm]": U, "Force [kN]": F}), ALL),
    "HDF5 in a group, units as attributes": ("a.h5", lambda: arrays("h5", time=T, displacement=U, force=F), ALL),
    "German dates over midnight": ("a.csv", text("Zeit;Weg [mm];Kraft [kN]") + "".join(
        f"{(stamp + timedelta(hours=14.4994)).strftime('%d.%m.%Y %H:%M:%S.%f')};{u};{f}\n" for stamp, u, f in zip(STAMPS, U, F, strict=True)), ALL),
    "US dates of one day": ("a.csv", text("Timestamp,Disp [mm],Force [kN]") + "".join(
        f"5/4/2024 9:30:{t:06.3f},{u},{f}\n" for t, u, f in zip(T, U, F, strict=True)), ALL),
    "the sign of mathematics for minus": ("a.csv", (text("Disp [mm],Force [kN]") + rows(U, F).replace("-", "\u2212")).encode(), PAIR),
    "Japanese, full-width units": ("a.csv", text("変位［ｍｍ］,荷重［ｋＮ］") + rows(U, F), PAIR),
    "a second time in ms": ("a.csv", text("Time [s],Time [ms],Disp [mm],Force [kN]") + rows(T, 1000 * T, U, F), ALL),
    "line ends of three systems": ("a.csv", "Time [s],Disp [mm],Force [kN]\r\n" + rows(T[:9], U[:9], F[:9]) + rows(T[9:20], U[9:20], F[9:20], end="\r")
        + rows(T[20:], U[20:], F[20:], end="\r\n"), ALL),
    "a mark of the encoding, big end first": ("a.csv", b"\xfe\xff" + (text("Time [s],Disp [mm],Force [kN]") + rows(T, U, F)).encode("utf-16-be"), ALL),
    "names in one row, parts of the rig above": ("a.csv", text(",Displacement,Force", "Time,top,actuator", "s,mm,kN") + rows(T, U, F), ALL),
    "quoted numbers": ("a.csv", text("U(mm),Force_kN") + "".join(f'"{u}","{f}"\n' for u, f in zip(U, F, strict=True)), PAIR),
    "symbols": ("a.csv", text("δ [mm],P [kN]") + rows(U, F), PAIR),
    "separators behind the last column": ("a.csv", text("Disp [mm],Force [kN],,") + rows(U, F, close=",,"), PAIR),
    "separated by bars": ("a.txt", text("Disp [mm]|Force [kN]") + rows(U, F, separator="|"), PAIR),
    "French without accents, kgf and cm": ("a.csv", text("deplacement_cm;force_kgf") + rows(U / 10, F * 1000 / 9.80665, separator=";", digits=[9, 9]), PAIR),
    "one decimal is enough for the others": ("a.csv", text("u [mm];F [kN]") + rows(U, F, separator=";", mark=",", digits=[3, 3]), PAIR),
}  # fmt: skip


def written(folder: Path, name: str, content) -> Path:
    path, content = folder / name, content() if callable(content) else content
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def right(made, channels):
    """Whether a campaign holds what was measured, in SI."""
    (experiment,) = made.campaign
    assert set(made.campaign.channels) == set(channels.split())
    assert_allclose(experiment.record["elongation"], 1e-3 * U, atol=1e-8)
    assert_allclose(experiment.record["force"], 1e3 * F, atol=1e-4)
    if "time" in channels:
        # Files that hold times of day begin at zero.
        assert_allclose(experiment.record.time, T, atol=2e-3)


@pytest.mark.parametrize("case", READ)
def test_a_file_of_a_logger_is_read_right_without_a_word(tmp_path, case):
    name, content, channels = READ[case]
    made = begun([written(tmp_path, name, content)], Said(held_out=0))
    right(made, channels)
    assert len(made.taken) == (3 if "time" in channels or channels == PAIR else 2)


THOUSANDS = np.where(np.arange(48) % 2, 1.288, 964)
ASKED = {
    "OpenSees recorder, no names": ("node.out", rows(T, U, F, separator=" "), "columns? of the elongation .* no column names"),
    "names without units": ("a.csv", text("t,du,F") + rows(T, U, F), "the unit of the elongation, column 'du'"),
    "names that say nothing": ("a.csv", text("A,B,C") + rows(T, U, F), "the column of the elongation"),
    "two displacements": ("a.csv", text("LVDT1 [mm],LVDT2 [mm],Force [kN]") + rows(U, 2 * U, F), "'LVDT1 .mm.', 'LVDT2 .mm.' may be it"),
    "two forces": ("a.csv", text("Disp [mm],Vertical load [kN],Horizontal load [kN]") + rows(U, F, F + 9), "the column of the force"),
    "a vertical load and a column in kN": ("a.csv", text("Disp [mm],Vertical load [kN],CH5 [kN]") + rows(U, F + 9, F), "the force"),
    "stress and strain beside force and extension": ("a.csv", text("Extension [mm],Force [kN],Strain [%],Stress [MPa]")
        + rows(U, F, DRIFT, 3 * F), "the column of the elongation"),
    "two times that differ": ("a.csv", text("Time [s],Disp [mm],Time [s],Force [kN]") + rows(T, U, T + 0.03, F), "the column of the time"),
    "a load in kg": ("a.csv", text("Disp [mm],Load [kg]") + rows(U, F), "the column of the force"),
    "a force in volts": ("a.csv", text("Disp [mm],Force [V]") + rows(U, F), "the column of the force"),
    "a word in the force": ("a.csv", text("u [mm],F [kN],u2 [mm]") + rows(U[:9], F[:9], U[:9]) + "1,off,2\n" + rows(U, F, U),
        "row 11, column 'F .kN.': 'off' is not a number"),
    "an error of a spreadsheet": ("a.csv", text("u [mm],F [kN]") + rows(U, F) + "1,#DIV/0!\n", "'#DIV/0!' is an error of the spreadsheet"),
    "missing inside": ("a.csv", text("t [s],u [mm],F [kN]") + rows(T[:9], U[:9], F[:9]) + "0.9,,5\n" + rows(T[10:], U[10:], F[10:]),
        "'u .mm.' is missing in row 11; say --drop-missing"),
    "a sentinel of a logger": ("a.csv", text("u [mm],F [kN]") + rows(U, np.where(np.arange(48) == 7, -9999, F)), "--missing -9999"),
    "an overflow": ("a.csv", text("u [mm],F [kN]") + rows(U, np.where(np.arange(48) == 7, 9.9e37, F)), "--missing 9.9e.37"),
    "thousands beside hundreds, tabs": ("a.txt", text("u [mm]\tF [N]") + rows(U, THOUSANDS, separator="\t"), "thousands separators"),
    "thousands with a comma, tabs": ("a.txt", text("u [mm]\tF [N]") + "".join(f"{k}\t{'1,288' if k % 2 else 964}\n" for k in range(20)),
        "thousands separators"),
    "thousands with a comma, quotes": ("a.csv", text("u [mm],F [N]") + "".join(f'{k / 2},"{1288 + k:,}"\n' for k in range(20)),
        "thousands separators"),
    "both marks": ("a.csv", text("u [mm];F [kN]") + rows(U, separator=";").replace("\n", ";1.234,5\n"), "thousands|is not a number"),
    "decimal commas between commas": ("a.csv", text("u [mm],F [kN]") + "0,1,2,5\n0,2,3,1\n0,3,3,9\n" * 8, "2 names stand above 4 columns"),
    "a comma in a name": ("a.csv", text("Force, horizontal [kN],Disp [mm]") + rows(F, U), "3 names stand above 2 columns"),
    "words in the middle": ("a.csv", text("u [mm],F [kN]") + rows(U, F) + "pause of the pump\n" + rows(U, F), "row 50: 'pause of the pump'"),
    "blanks, a sample is missing": ("a.dat", text("t[s] u[mm] F[kN]") + rows(T, U, F, separator=" ") + "4.9 3.3\n" + rows(T, U, F, separator=" "),
        "row 50: 2 numbers where other rows have 3"),
    "Excel, text in place of numbers": ("a.xlsx", lambda: xlsx(("data", [["Disp [mm]", "Load [kN]"], *table(U, F), [1.5, "2,5"]])),
        "row 50, column 2 holds the text '2,5'"),
    "Excel, two sheets with tables": ("a.xlsx", lambda: xlsx(*((t, [["Disp [mm]", "Load [kN]"], *table(U, F)]) for t in ("A", "B"))),
        "several sheets .* --sheet NAME"),
    "a matrix of MATLAB": ("a.mat", lambda: arrays("mat", data=np.column_stack([T, U, F])), "'data\\(:,1\\)'"),
    "no numbers": ("a.csv", "hello\nworld\n", "no row has numbers"),
    "an old workbook": ("a.xls", b"\xd0\xcf\x11\xe0", "save an older workbook as .xlsx"),
    "thousands with a point, German": ("a.csv", text("Disp [mm];Force [N]") + "0,01;1.410,0\n0,02;1.420,5\n" * 9, "'1.410,0' has .* thousands"),
    "thousands with an apostrophe, Swiss": ("a.csv", text("Disp [mm];Force [N]") + "0.01;1'410.0\n0.02;964.5\n" * 9, "410.0. has .* thousands"),
    "thousands with a blank, tabs": ("a.txt", text("Disp [mm]\tForce [N]") + "0.01\t1 410.0\n0.02\t964.5\n" * 9, "'1 410.0' has .* thousands"),
    "a cell too many": ("a.csv", text("Disp [mm],Force [kN]") + rows(U[:9], F[:9]) + "1,2,7\n" + rows(U, F), "row 11: 3 cells where row 1 names 2 columns"),
    "one row": ("a.csv", text("Disp [mm],Force [kN]") + "1,2\n", "one row of numbers; a record has two"),
    "no rows": ("a.csv", text("Disp [mm],Force [kN]"), "no row has numbers"),
    "nothing": ("a.csv", "\n  \n", "the file is empty"),
    "only a hidden sheet": ("a.xlsx", lambda: xlsx(("raw", [["Disp [mm]", "Load [kN]"], *table(U, F)]), ("notes", [["x"]]), hidden=("raw",)),
        "sheet 'raw' is hidden and is left out"),
    "Excel, all numbers as text": ("a.xlsx", lambda: xlsx(("data", [["Disp [mm]", "Load [kN]"], *([str(u), str(f)] for u, f in zip(U, F, strict=True))])),
        "row 2 holds '0.013' as text; format the cells as numbers"),
    "a text that is called a workbook": ("a.xlsx", text("Disp [mm],Force [kN]") + rows(U, F), "not a workbook; if it is a text file, give it the extension .csv"),
    "two tables, one below the other": ("a.csv", text("Disp [mm],Force [kN]") + rows(U, F) + "\n" + text("Disp [mm],Moment [kNm]") + rows(U, F),
        "row 51: 'Disp .mm. Moment .kNm.' stands between rows of numbers"),
    "a force of a factor": ("a.csv", text("Disp [mm],Force [x1000 N]") + rows(U, F), "the column of the force"),
    "US dates of two days": ("a.csv", text("Time,Disp [mm],Force [kN]") + "".join(f"5/{4 + k // 9}/2024 9:30:{k:02d},{k},{k}\n" for k in range(18)),
        "is a date or a time of day"),
    "times of day with AM": ("a.csv", text("Time,Disp [mm],Force [kN]") + "".join(f"9:30:{k:02d} AM,{k},{k}\n" for k in range(18)), "is a date or a time of day"),
    "percent in the cells": ("a.csv", text("Drift,Force [kN]") + "".join(f"{u}%,{f}\n" for u, f in zip(U, F, strict=True)), "is not a number; .* no unit"),
    "a time of two readings": ("a.csv", text("Time [s],Elapsed time [s],Disp [mm],Force [kN]") + rows(T, T + 3, U, F), "the column of the time"),
    "lvm, two measurements": ("a.lvm", 2 * (LVM.format(mark=".", x="One") + text("X_Value\tWeg\tKraft\tComment", end="\r\n")
        + rows(T, U, F, separator="\t", digits=[6, 6, 6], end="\r\n")), "a second measurement begins"),
}  # fmt: skip


@pytest.mark.parametrize("case", ASKED)
def test_what_a_file_does_not_tell_is_asked_in_one_message(tmp_path, case):
    name, content, message = ASKED[case]
    with pytest.raises(UserError, match=f"(?s){message}") as caught:
        begun([written(tmp_path, name, content)], Said(held_out=0))
    assert name in str(caught.value) or "record" in str(caught.value)


@pytest.mark.parametrize("names", [("disp.txt", "load.txt"), ("Displacement.csv", "Force.csv")])
def test_files_of_one_column_each_are_one_record(tmp_path, names):
    heads = ("Weg [mm]\n", "Kraft [kN]\n") if names[0] == "disp.txt" else ("", "")
    files = [written(tmp_path, name, head + rows(v)) for name, head, v in zip(names, heads, (U, F), strict=True)]
    units = {} if heads[0] else {"elongation": "mm", "force": "kN"}
    right(begun(files, Said(units=units, held_out=0)), PAIR)
    written(tmp_path, names[1], heads[1] + rows(F[1:]))
    with pytest.raises(UserError, match="differ in length"):
        begun(files)


def test_flags_say_what_a_file_does_not(tmp_path):
    path = written(tmp_path, "node.out", rows(T, U + 3, 0 * U + 3, -F, separator=" "))
    columns = {"time": "1", "elongation": "2 - 3", "force": "- 4"}
    right(begun([path], Said(columns, {"elongation": "mm", "force": "kN", "1": "s"}, held_out=0)), ALL)


def test_missing_samples_are_cut_dropped_or_marked_as_the_user_says(tmp_path):
    lines = rows(T, U, F).splitlines()
    lines[:2] = ["0,,1", "0.1,nan,1"]
    lines[20] = f"{T[20]},-9999,{F[20]}"
    path = written(tmp_path, "a.csv", text("Time [s],Disp [mm],Load [kN]", *lines))
    with pytest.raises(UserError, match="--drop-missing"):
        begun([path], Said(missing=(-9999.0,)))
    made = begun([path], Said(missing=(-9999.0,), drops_missing=True, held_out=0))
    left = np.delete(np.arange(48), [0, 1, 20])
    assert_allclose(made.campaign["a"].record["force"], 1e3 * F[left])
    assert any("rows 2 to 3 at the start are cut off" in note for note in made.notes)
    assert any("row 22" in note and "left out" in note for note in made.notes)
    kept = begun([path], Said(missing=(), held_out=0)).campaign["a"].record
    assert kept["elongation"].min() == -9.999


def test_a_hidden_sheet_a_footer_and_what_is_not_used_are_said(tmp_path):
    hidden, content, _ = READ["Excel with titles, units in a row, a hidden sheet"]
    notes = begun([written(tmp_path, hidden, content)]).notes
    assert any("sheet 'raw' is hidden and is left out" in note for note in notes)
    name, content, _ = READ["a footer with the largest values"]
    assert any(
        "row 50 below the table is left out: 'Max 11.2 43.1'" in n
        for n in begun([written(tmp_path, name, content)]).notes
    )
    name, content, _ = READ["millivolts beside"]
    assert "not used: 'Excitation [mV]'" in begun([written(tmp_path, name, content)]).notes


def test_a_row_of_numbers_behind_an_empty_row_is_said(tmp_path):
    path = written(tmp_path, "a.csv", text("Disp [mm],Load [kN]") + rows(U, F) + "\n11.2,43.1\n")
    assert any("row 51, below an empty row, is read as a sample: '11.2 43.1'" in note for note in begun([path]).notes)
    path = written(tmp_path, "b.csv", text("Disp [mm],Load [kN]") + rows(U[:20], F[:20]) + "\n" + rows(U[20:], F[20:]))
    assert not any("empty row" in note for note in begun([path]).notes)


def test_a_drift_ratio_tells_a_height_that_no_specimen_has(tmp_path):
    body = rows(U, F, np.round(U / 12, 5))  # mm over 1.2 m, in percent
    (tmp_path / "wall.csv").write_text(text("Disp [mm],Load [kN],Drift [%]") + body)
    assert begun([tmp_path / "wall.csv"]).doubts == []
    (tmp_path / "wall.csv").write_text(text("Disp [m],Load [kN],Drift [%]") + body)
    (doubt,) = begun([tmp_path / "wall.csv"]).doubts
    assert (doubt.kind, doubt.channel) == ("unit", "elongation") and "1.2e+03 m high" in doubt.message


def test_a_third_of_a_record_is_held_out(tmp_path):
    path = written(tmp_path, "a.csv", text("Disp [mm],Load [kN]") + rows(U, F))
    train, test = begun([path]).campaign
    assert (train.split, train.window, test.split, test.window) == ("train", (0, 31), "test", (32, 47))
    assert [e.split for e in begun([path], Said(held_out=0)).campaign] == ["train"]


WALLS = sorted((SHARED / "data/stone_masonry/curves").glob("*.csv"))


def check_walls(paths):
    for path in paths:
        made = begun([path], Said(held_out=0))
        # By the definition of the files: three rows of titles and names, one of units, and numbers.
        lines = path.read_bytes().decode("latin-1").splitlines()[4:]
        numbers = [[float(cell or "nan") for cell in line.split(",")[:2]] for line in lines]
        table = np.array([row for row in numbers if not np.isnan(row).any()])
        (experiment,) = made.campaign
        assert {c: made.campaign.unit(c).text for c in made.campaign.channels} == {"elongation": "mm", "force": "kN"}, (
            path
        )
        assert_allclose(experiment.record["elongation"], 1e-3 * table[:, 0], rtol=1e-12, err_msg=path.name)
        assert_allclose(experiment.record["force"], 1e3 * table[:, 1], rtol=1e-12, err_msg=path.name)
        assert "column 'top_displacement [mm]'" in made.taken[0] and "column 'horizontal_force [kN]'" in made.taken[1]


@pytest.mark.skipif(not WALLS, reason="the curves of the stone masonry walls are not there")
def test_raw_curves_of_walls_are_read_without_a_flag():
    check_walls(path for path in WALLS if path.stat().st_size < 30_000)


@pytest.mark.slow
@pytest.mark.skipif(not WALLS, reason="the curves of the stone masonry walls are not there")
def test_all_raw_curves_of_walls_are_read_without_a_flag():
    check_walls(WALLS)
