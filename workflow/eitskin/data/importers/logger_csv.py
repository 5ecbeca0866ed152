"""The paper's rig logger: one CSV row a depth step, 256 magnitudes drive-major (16 x 16).

`eit_{16 k + j}` is |u[j] - u[j+1]| (V) while electrodes k, k+1 drive. The 48 readings whose pair
touches a driven electrode hold no measurement and must be constant: channels are picked by index,
never by value (a real reading may be 0). Rows with `force_n` under 0.05 N are the untouched
baseline, rows from 0.5 N on are touches at `contact_u_m`, `contact_v_m` (the robot's axes), as the
paper takes them. Rows between are neither, rows without a force or a frame are nothing: they are
left out and counted in `source`. The clock is `t_eit`; the skin's size, the probe and the current
are not in the file.
"""

from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin import text_file
from eitskin.data.importers.description import describe
from eitskin.data.importers.tables import cells, first_line, separator_of
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table

N_ELECTRODES = 16
UNTOUCHED_BELOW_N = 0.05
TOUCHED_FROM_N = 0.5
MOST = 1 << 31  # contacts
NEEDED = ("contact_idx", "contact_u_m", "contact_v_m", "depth_m", "force_n", "t_eit")
SOURCE = (
    "logger of knazari/eit_hybrid_state_estimation, {name} (left out: {between} rows between "
    "{untouched} N and {touched} N, {empty} without a force or a frame)"
)


def matches(path: Path) -> bool:
    """Whether the header is the logger's."""
    return {"contact_idx", "force_n", "t_eit", "eit_0"} <= set(cells(first_line(path)))


def load(path: Path) -> Recording:
    """One frame a kept row; raises InputError for missing columns, words among numbers, live
    readings at driven electrodes, or time going backwards (several runs in one file).
    """
    readings = [f"eit_{index}" for index in range(N_ELECTRODES**2)]
    table = _read(path, [*NEEDED, *readings])
    values = table[readings].to_numpy()
    channels = channel_table(N_ELECTRODES)
    measured = N_ELECTRODES * channels[:, 0] + channels[:, 2]
    _refuse_live(path, table, np.setdiff1d(np.arange(N_ELECTRODES**2), measured))
    force = table["force_n"].to_numpy()
    empty = np.isnan(force) | table["t_eit"].isna().to_numpy() | np.isnan(values).all(axis=1)
    between = ~empty & (force >= UNTOUCHED_BELOW_N) & (force < TOUCHED_FROM_N)
    kept = table[~empty & ~between]
    if kept.empty:
        expected = f"some under {UNTOUCHED_BELOW_N} N or from {TOUCHED_FROM_N} N on"
        raise InputError(path, "rows", "none of use", expected)
    time = kept["t_eit"].to_numpy()
    backwards = np.flatnonzero(np.diff(time) <= 0)
    if len(backwards):
        line = kept.index[backwards[0] + 1]
        expected = f"more than {time[backwards[0]]}; import each run of the logger by itself"
        raise InputError(path, f"line {line}, column t_eit", table["t_eit"][line], expected)
    touch = kept["force_n"].to_numpy() >= TOUCHED_FROM_N
    frames = frames_table(
        time - time[0],
        touch,
        kept["contact_u_m"] * 1e3,
        kept["contact_v_m"] * 1e3,
        kept["force_n"],
        depth_mm=kept["depth_m"] * 1e3,
    )
    frames["contact"] = _contacts(path, kept["contact_idx"].where(touch))
    source = SOURCE.format(
        name=path.name,
        between=int(between.sum()),
        untouched=UNTOUCHED_BELOW_N,
        touched=TOUCHED_FROM_N,
        empty=int(empty.sum()),
    )
    metadata = describe(
        channels,
        even_angles(N_ELECTRODES),
        source,
        voltage="magnitude",
        position_frame="robot",
        unit="V",
        clock="measured",
    )
    voltage = kept[readings].to_numpy()[:, measured]
    return Recording(frames, voltage, None, None, metadata)


def _read(path: Path, names: list[str]) -> pd.DataFrame:
    """The named columns as float64, NaN where a cell is empty, by the file's lines, from 1; cells
    stand between commas, or between semicolons or tabs, then perhaps with decimal commas."""
    text = text_file.read(path)
    separator = separator_of(text.partition("\n")[0])
    blank = " \t".replace(separator, "")
    lines = [k for k, line in enumerate(text.split("\n"), 1) if line.strip(blank)]
    try:
        table = pd.read_csv(StringIO(text), sep=separator, dtype=str, keep_default_na=False)
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise InputError(path, "file", reason, "the logger's CSV") from error
    if not isinstance(table.index, pd.RangeIndex):
        # pandas has taken the first cells for names of rows.
        raise InputError(path, f"line {lines[1]}", "more cells than the header has", "as many")
    if len(lines) != 1 + len(table):
        raise InputError(path, "file", "a row of several lines", "a line a row")
    table.index = lines[1:]
    columns = {}
    for name in names:
        if name not in table:
            raise InputError(
                path, f"column {name}", "nothing", f"{', '.join(NEEDED)}, eit_0 ... 255"
            )
        written = table[name].fillna("")
        if separator != ",":
            written = written.str.replace(",", ".", regex=False)
        columns[name] = pd.to_numeric(written, errors="coerce").astype(float)
        words = columns[name].isna() & ~written.str.lower().isin(["", "nan", "none"])
        bad = words | np.isinf(columns[name])
        if bad.any():
            line = bad.idxmax()
            raise InputError(path, f"line {line}, column {name}", repr(written[line]), "a number")
    return pd.DataFrame(columns)


def _contacts(path: Path, numbers: pd.Series) -> pd.Series:
    """The presses' numbers as whole ones, a frame each; raises InputError where one is none."""
    wrong = numbers[numbers.notna() & ~((numbers >= 0) & (numbers < MOST) & (numbers % 1 == 0))]
    if len(wrong):
        line, found = next(wrong.items())
        expected = f"a whole number, 0 to {MOST - 1}"
        raise InputError(path, f"line {line}, column contact_idx", found, expected)
    return numbers.reset_index(drop=True).astype("Int64")


def _refuse_live(path: Path, table: pd.DataFrame, driven: np.ndarray) -> None:
    """Readings at driven electrodes must not change: else the file's order is another one."""
    for index in driven:
        cells = table[f"eit_{index}"].dropna()
        changed = cells[cells != cells.iloc[0]] if len(cells) else cells
        if len(changed):
            line, found = next(changed.items())
            drive, pair = divmod(int(index), N_ELECTRODES)
            expected = f"{cells.iloc[0]} throughout: pair {pair} touches drive {drive}"
            raise InputError(path, f"line {line}, column eit_{index}", found, expected)
