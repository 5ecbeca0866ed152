"""The paper's rig logger: one CSV row a depth step, `eit_0`, ... as the board `circular-16` prints.

Readings whose pair touches a driven electrode hold no measurement and must be constant: channels
are picked by index, never by value (a real reading may be 0). Rows with `force_n` under 0.05 N are
the untouched baseline, rows from 0.5 N on are touches at `contact_u_m`, `contact_v_m` (the robot's
axes), as the paper takes them. Rows between are neither, rows without a force or a frame are
nothing: they are left out and counted in `source`. The clock is `t_eit`; the skin's size, the probe
and the current are not in the file.
"""

from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin import text_file
from eitskin.data import board
from eitskin.data.board import Board
from eitskin.data.importers.description import describe
from eitskin.data.importers.tables import cells, first_line, separator_of
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles

BOARD = "circular-16"
FILES = (board.FOLDER / f"{BOARD}{board.SUFFIX}",)
UNTOUCHED_BELOW_N = 0.05
TOUCHED_FROM_N = 0.5
MAX_CONTACTS = 1 << 31  # contacts
REQUIRED_COLUMNS = ("contact_idx", "contact_u_m", "contact_v_m", "depth_m", "force_n", "t_eit")
SOURCE = (
    "logger of knazari/eit_hybrid_state_estimation, {name} (left out: {between} rows between "
    "{untouched} N and {touched} N, {empty} without a force or a frame)"
)


def matches(path: Path) -> bool:
    """Whether the header is the logger's."""
    return {"contact_idx", "force_n", "t_eit", "eit_0"} <= set(cells(first_line(path)))


def load(path: Path) -> Recording:
    """One frame for each used row.

    Raises InputError for missing columns, words among numbers, changing readings at driven
    electrodes, and times that do not increase (several runs in one file).
    """
    eit_board = board.read(BOARD)
    readings = [f"eit_{index}" for index in range(len(eit_board.printed))]
    table = _read(path, [*REQUIRED_COLUMNS, *readings])
    values = table[readings].to_numpy()
    _refuse_live(path, table, eit_board)
    force = table["force_n"].to_numpy()
    is_empty = np.isnan(force) | table["t_eit"].isna().to_numpy() | np.isnan(values).all(axis=1)
    is_between = ~is_empty & (force >= UNTOUCHED_BELOW_N) & (force < TOUCHED_FROM_N)
    used_rows = table[~is_empty & ~is_between]
    if used_rows.empty:
        expected = f"some under {UNTOUCHED_BELOW_N} N or from {TOUCHED_FROM_N} N on"
        raise InputError(path, "rows", "none of use", expected)
    time = used_rows["t_eit"].to_numpy()
    backwards = np.flatnonzero(np.diff(time) <= 0)
    if len(backwards):
        line = used_rows.index[backwards[0] + 1]
        expected = f"more than {time[backwards[0]]}; import each run of the logger by itself"
        raise InputError(path, f"line {line}, column t_eit", table["t_eit"][line], expected)
    touch = used_rows["force_n"].to_numpy() >= TOUCHED_FROM_N
    frames = frames_table(
        time - time[0],
        touch,
        used_rows["contact_u_m"] * 1e3,
        used_rows["contact_v_m"] * 1e3,
        used_rows["force_n"],
        depth_mm=used_rows["depth_m"] * 1e3,
    )
    frames["contact"] = _contacts(path, used_rows["contact_idx"].where(touch))
    source = SOURCE.format(
        name=path.name,
        between=int(is_between.sum()),
        untouched=UNTOUCHED_BELOW_N,
        touched=TOUCHED_FROM_N,
        empty=int(is_empty.sum()),
    )
    metadata = describe(
        eit_board.channels,
        even_angles(eit_board.n_electrodes),
        source,
        voltage=eit_board.voltage,
        position_frame="robot",
        unit=eit_board.unit,
        clock="measured",
    )
    voltage = used_rows[readings].to_numpy()[:, eit_board.is_recorded]
    return Recording(frames, voltage, None, None, metadata)


def _read(path: Path, names: list[str]) -> pd.DataFrame:
    """The named columns as float64, NaN where a cell is empty, indexed by the file's lines from 1.

    Cells are separated by commas, or by semicolons or tabs with decimal points or commas.
    """
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
                path, f"column {name}", "nothing", f"{', '.join(REQUIRED_COLUMNS)}, eit_0 ... 255"
            )
        cell_text = table[name].fillna("")
        if separator != ",":
            cell_text = cell_text.str.replace(",", ".", regex=False)
        columns[name] = pd.to_numeric(cell_text, errors="coerce").astype(float)
        is_word = columns[name].isna() & ~cell_text.str.lower().isin(["", "nan", "none"])
        is_bad = is_word | np.isinf(columns[name])
        if is_bad.any():
            line = is_bad.idxmax()
            raise InputError(path, f"line {line}, column {name}", repr(cell_text[line]), "a number")
    return pd.DataFrame(columns)


def _contacts(path: Path, numbers: pd.Series) -> pd.Series:
    """The number of each frame's press as an integer; raises InputError where one is not."""
    bad_numbers = numbers[
        numbers.notna() & ~((numbers >= 0) & (numbers < MAX_CONTACTS) & (numbers % 1 == 0))
    ]
    if len(bad_numbers):
        line, bad_number = next(bad_numbers.items())
        expected = f"a whole number, 0 to {MAX_CONTACTS - 1}"
        raise InputError(path, f"line {line}, column contact_idx", bad_number, expected)
    return numbers.reset_index(drop=True).astype("Int64")


def _refuse_live(path: Path, table: pd.DataFrame, eit_board: Board) -> None:
    """Raise InputError where readings at driven electrodes change: the file has another order."""
    for index in np.flatnonzero(~eit_board.is_recorded):
        cells = table[f"eit_{index}"].dropna()
        changed_cells = cells[cells != cells.iloc[0]] if len(cells) else cells
        if len(changed_cells):
            line, reading = next(changed_cells.items())
            drive, _, pair, _ = eit_board.printed[index]
            expected = f"{cells.iloc[0]} throughout: pair {pair} touches drive {drive}"
            raise InputError(path, f"line {line}, column eit_{index}", reading, expected)
