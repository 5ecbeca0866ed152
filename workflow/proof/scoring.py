"""The score of an opened block: every claim beside its gate and its target, reached or not.

A case is a row of the form that `proof.trial.trial` makes; shares, F1, intervals and the
rules for names and sites are `calibration`'s. A case whose diagnosis broke off counts as one that
said nothing: an alarm where nothing was concealed, a miss elsewhere.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import norm

from eitskin.data import parquet
from eitskin.effects import EFFECTS
from eitskin.effects.effect import LeakEffect
from eitskin.errors import InputError
from proof import baselines, judge, lines, opened, planted, score, verdicts
from proof.intervals import rms

FRACTION_90 = 2 * norm.isf(0.05)  # of an interval of 90 %, in standard deviations
SHOWN = 5.0  # gap from which an effect has to be noticed
APART = score.APART
WEAK = (3.0, 5.0)
SAID_NOTHING = {
    "verdict": "broken off",
    "effects": [],
    "other": {"probability": 0.0, "sentence": None},
}
KINDS = {"confusable": "pair"}  # kinds of a case that are scored as another
BOXES = ("gp", "mlp")
METHODS = (*baselines.METHODS, "eitskin", "oracle")
LINE = (
    *("of", "what", "value", "low", "high", "hits", "n", "ceiling"),
    *("gate", "gate_met", "target", "target_met"),
)
HIGHEST = np.inf


def rows(block: Path) -> list[dict]:
    """One row a case of an opened block, in order: the truth, what was said, how the hidden frames
    (the query, without noise) were predicted, by whom."""
    return [_row(block, case) for case in opened.cases(block / "opened")]


def _row(block: Path, case: str) -> dict:
    truth, arrays = opened.read(block / "opened", case)
    verdict = block / "verdicts" / case
    said = _json(verdict / "diagnosis.json")
    told, best = (_json(block / part / f"{case}.json") for part in ("baselines", "oracle"))
    word, _, of = truth["kind"].partition(":")
    row = {
        "case": case,
        "seed": int(case.rpartition("-")[2]),
        "kind": KINDS.get(word, word),
        "group": word,
        "absent": of if word == "decoy" else None,
        "generator": truth["generator"],
        "strength": truth["gap_wanted"],
        "truth": truth["effects"],
        "scopes": truth["scopes"],
        "true_gaps": truth["gaps"] or [None] * len(truth["effects"]),
        "outside": truth["outside"],
        "fault": truth.get("fault"),
        "rig": truth.get("rig", []),
        "control": best.get("control"),
        "level": truth["level"],
        "changed": truth["changed"],
        "similarity": truth["similarity"],
        "snr_left": best.get("snr_left") or np.nan,
        "best": best.get("effects"),
        "log_evidence": best.get("log_evidence"),
        "said_log_evidence": best.get("said_log_evidence"),
        "baselines": told.get("effects", {}),
        "broken": [n for n, made in (("baselines", told), ("oracle", best)) if "failed" in made],
        "said": SAID_NOTHING if "failed" in said else said,
        **({"failed": said["failed"]} if "failed" in said else {}),
    }
    took = block / verdicts.SECONDS / f"{case}.json"
    if took.is_file():
        row["seconds"] = _json(took)["seconds"]
    if "query_clean_V" not in arrays:
        return {**row, "hidden": _hidden({})}
    clean = arrays["query_clean_V"]
    hidden = {"oracle": best.get("rmse_V")}
    if "failed" not in told:
        with np.load(block / "baselines" / f"{case}.npz", allow_pickle=False) as file:
            hidden |= {name: rms(file[name] - clean) for name in file.files}
    if "failed" not in said:
        voltage, sd = predicted(verdict / "predicted.parquet", clean.shape)
        error = voltage - clean
        hidden |= {
            "eitskin": rms(error),
            "chi2_per_dof": float(1.0 + ((error / arrays["noise_V"]) ** 2).mean()),
            "within_90": float((np.abs(error) <= 0.5 * FRACTION_90 * sd).mean()),
        }
    return {**row, "hidden": _hidden(hidden)}


def _hidden(told: dict) -> dict[str, float]:
    keys = (*METHODS, "chi2_per_dof", "within_90")
    return {key: np.nan if told.get(key) is None else told[key] for key in keys}


def _json(path: Path) -> dict:
    if not path.is_file():
        raise InputError(path, "file", "no such file", "a result of every case")
    return json.loads(path.read_text("utf-8"))


def predicted(path: Path, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Predicted voltages of a query (Q, M) and their standard deviations."""
    table = parquet.read(path, ["voltage_V", "std_V"])
    flat = (table[name].combine_chunks().flatten() for name in table.column_names)
    voltage, sd = (one.to_numpy(zero_copy_only=False).reshape(-1, shape[1]) for one in flat)
    if voltage.shape != shape:
        raise InputError(path, "voltage_V", f"{voltage.shape}", f"{shape}, as the query")
    return voltage, sd


def side(name: str) -> str:
    """instrument (wires, readings, scan) or skin (touches and all that they press)."""
    effect = EFFECTS[name]
    if isinstance(effect, LeakEffect) and effect.on_contact:
        return "skin"
    return "instrument" if effect.stage in ("wiring", "instrument", "clock") else "skin"


def smallest_gap(row: dict) -> float:
    """The smallest gap of a case's effects to a name outside their class; NaN where unknown."""
    return min((judge.next_gap(gaps) for gaps in row["true_gaps"]), default=float("nan"))


def noticed(row: dict) -> bool:
    """Whether a diagnosis says that something is left out, with a name or without."""
    return bool(row["said"]["effects"]) or score.flagged(row)


def misfit_closed(hidden: dict[str, float], method: str = "eitskin") -> float:
    """(RMSE before - RMSE) / (RMSE before - RMSE of the oracle); NaN where the oracle is no better
    than the owner's belief."""
    possible = hidden["none"] - hidden["oracle"]
    return (hidden["none"] - hidden[method]) / possible if possible > 0 else float("nan")


def errors(row: dict) -> list[float]:
    """Of each rightly named effect: the median over its numbers of |error| over the Cramér-Rao
    bound's standard deviation, which the oracle's intervals show."""
    made: list[float] = []
    if row["best"] is None:
        return made
    named = judge.matched(row)
    for item, scope, found, best in zip(
        row["truth"], row["scopes"], named, row["best"], strict=True
    ):
        if found is None or found["name"] != item["name"]:
            continue
        bound = {(n.key, n.place): n.high - n.low for n in judge.numbers(best, item, scope)}
        ratio = [
            abs(n.value - n.true) * FRACTION_90 / bound[n.key, n.place]
            for n in judge.numbers(found, item, scope)
            if bound.get((n.key, n.place), 0.0) > 0
        ]
        if ratio:
            made.append(float(np.median(np.nan_to_num(ratio, nan=np.inf))))
    return made


@dataclass(frozen=True)
class Claim:
    """A line of the table: what is measured, over which rows, and what is asked of it.

    measure(rows) gives a line of `proof.lines`; gate, target: (lowest, highest) value, None
    where nothing is asked; ceiling(rows): the best that is possible, where that is known.
    """

    measure: Callable[[list[dict]], dict]
    gate: tuple[float, float] | None = None
    target: tuple[float, float] | None = None
    ceiling: Callable[[list[dict]], float] | None = None


def _of(kind: str, rows: list[dict]) -> list[dict]:
    return [row for row in rows if row["kind"] == kind]


def _with_effects(rows: list[dict]) -> list[dict]:
    return [row for row in rows if row["truth"] and not row["outside"]]


def _band(rows: list[dict], low: float, high: float = HIGHEST) -> list[dict]:
    return [row for row in rows if low <= smallest_gap(row) < high or smallest_gap(row) == high]


def _planted(rows: list[dict]) -> dict:
    """Faults planted in real recordings, against what is named of the same frames without."""
    own = [row for row in _of("real", rows) if row["fault"]]
    hits = sum("failed" not in row and fault_found(row) for row in own)
    return lines.share("a fault in a real recording", "found, at its site", hits, len(own))


def fault_found(row: dict) -> bool:
    """Whether the fault planted in a real recording was found, or borne where channels are lost, as
    of `planted.found`."""
    return planted.found(row["said"], {"effects": row["control"] or []}, row["fault"])


def _false_alarms(rows: list[dict]) -> dict:
    nulls = _of("null", rows)
    alarms = sum("failed" in row or noticed(row) for row in nulls)
    return lines.share("nothing concealed", "false alarm, of any kind", alarms, len(nulls))


def _decoys(rows: list[dict]) -> dict:
    """How often what only looks as if it were there is named outright."""
    own = _of("decoy", rows)
    alarms = sum(
        "failed" in row or any(e["name"] == row["absent"] for e in row["said"]["effects"])
        for row in own
    )
    return lines.share("a decoy", "named what it looks like", alarms, len(own))


def _decoys_named(rows: list[dict]) -> dict:
    own = _of("decoy", rows)
    hits = sum(_right(row) == len(row["said"]["effects"]) == 1 for row in own)
    return lines.share("a decoy", "right name or declared class", hits, len(own))


def _right(row: dict) -> int:
    return sum(found is not None for found in judge.matched(row))


def _detected(rows: list[dict]) -> dict:
    own = _band(_with_effects(rows), SHOWN)
    what = f"something noticed, gap ≥ {SHOWN:g}"
    return lines.share("an effect", what, sum(map(noticed, own)), len(own))


def _named(low: float, high: float, rows: list[dict]) -> dict:
    own = _band(_of("single", rows), low, high)
    text = f"gap ≥ {low:g}" if high == HIGHEST else f"gap {low:g} to {high:g}"
    hits = int(score.effects(own)["right"].sum())
    return lines.share("one effect", f"right name or declared class, {text}", hits, len(own))


def _ceiling(low: float, high: float, rows: list[dict]) -> float:
    """Φ(gap / 2), the accuracy of the best test between two names, in the mean."""
    own = [smallest_gap(row) for row in _band(_of("single", rows), low, high)]
    return float(norm.cdf(0.5 * np.array(own)).mean()) if own else float("nan")


def set_f1(rows: list[dict], of: str, what: str) -> dict:
    """F1 of the effects said, over all rows."""
    right = np.array([_right(row) for row in rows])
    true = np.array([len(row["truth"]) for row in rows])
    said = np.array([len(row["said"]["effects"]) for row in rows])
    return lines.over(of, what, len(rows), score.f1(right, true, said))


def _sets(kind: str, least: float, rows: list[dict]) -> dict:
    of = {"pair": "two effects", "triple": "three effects"}[kind]
    own = _of(kind, rows)
    if least > 0:
        own = _band(own, least)
    return set_f1(own, of, f"F1 of the set, each gap ≥ {least:g}" if least else "F1 of the set")


def _sides(rows: list[dict]) -> dict:
    """Among single effects for which something is named."""
    own = [row for row in _of("single", rows) if row["said"]["effects"]]
    hits = sum(
        all(side(e["name"]) == side(row["truth"][0]["name"]) for e in row["said"]["effects"])
        for row in own
    )
    return lines.share("one effect, something named", "instrument or skin, rightly", hits, len(own))


def _sited(kinds: tuple[str, ...], least: float, rows: list[dict]) -> dict:
    own = _band(_of("single", rows), least) if least else _of("single", rows)
    own = [
        row
        for row in own
        if row["scopes"][0] == "sparse" and judge.site_kind(row["truth"][0]) in kinds
    ]
    hits = sum(
        any(judge.sites_right(found, row["truth"][0]) for found in row["said"]["effects"])
        for row in own
    )
    text = "electrode exactly right" if kinds == ("electrodes",) else "site exactly right"
    return lines.share("one effect", text + (f", gap ≥ {least:g}" if least else ""), hits, len(own))


def _errors(rows: list[dict]) -> dict:
    ratio = np.array([one for row in rows for one in errors(row)])
    what = "error over its Cramér-Rao sd, median (efficient: 0.67)"
    return lines.over("rightly named", what, len(ratio), lines.median(ratio))


def _coverage(rows: list[dict]) -> dict:
    return score.coverage(
        "rightly named", "90 % intervals that hold the truth", score.effects(rows)
    )


def _closed(rows: list[dict]) -> dict:
    closed = np.array([misfit_closed(row["hidden"]) for row in _with_effects(rows)])
    return _median("an effect, hidden frames", "misfit closed (1 = oracle), median", closed)


def _chi2(rows: list[dict]) -> dict:
    chi2 = np.array([row["hidden"]["chi2_per_dof"] for row in _with_effects(rows)])
    return _median("an effect, hidden frames", "χ²/dof, median", chi2)


def against_boxes(row: dict) -> float:
    """How many times larger the better black box's RMSE on hidden frames is."""
    return min(row["hidden"][box] for box in BOXES) / row["hidden"]["eitskin"]


def _boxes(rows: list[dict]) -> dict:
    times = np.array([against_boxes(row) for row in _with_effects(rows)])
    what = "RMSE of the best black box (GP, NN) over ours, median"
    return _median("an effect, hidden frames", what, times)


def _median(of: str, what: str, values: np.ndarray) -> dict:
    """Of what is known."""
    known = values[~np.isnan(values)]
    return lines.over(of, what, len(known), lines.median(known))


def _flagged(least: float, rows: list[dict]) -> dict:
    own = [row for row in rows if row["outside"]]
    if least:
        own = [row for row in own if row["snr_left"] >= least]
    text = f"flagged, SNR ≥ {least:g} after the best fit" if least else "flagged"
    return lines.share("outside the catalogue", text, sum(map(score.flagged, own)), len(own))


def _auroc(rows: list[dict]) -> dict:
    there = np.array([bool(row["outside"]) for row in rows], bool)
    said = np.array([row["said"]["other"]["probability"] for row in rows], float)

    def area(index: np.ndarray) -> float:
        hit, probability = there[index], said[index]
        return score.auroc(probability[hit], probability[~hit])

    return lines.over("outside the catalogue, and all others", "AUROC", len(rows), area)


def _falsely_flagged(rows: list[dict]) -> dict:
    own = [row for row in rows if not row["outside"]]
    hits = sum(map(score.flagged, own))
    return lines.share("nothing outside the catalogue", "falsely flagged", hits, len(own))


def _seconds(rows: list[dict]) -> dict:
    took = np.array([row.get("seconds", np.nan) for row in rows])
    return _median("every recording", "seconds a diagnosis, median", took)


def _within(rows: list[dict]) -> dict:
    inside = np.array([row["hidden"]["within_90"] for row in _with_effects(rows)])
    return _median("an effect, hidden frames", "noise-free values within the 90 % bands", inside)


def _broken(rows: list[dict]) -> dict:
    hits = sum("failed" in row for row in rows)
    return lines.share("every recording", "diagnosis broken off", hits, len(rows))


def _all_right(rows: list[dict]) -> dict:
    own = [row for row in rows if row["kind"] in ("pair", "triple")]
    hits = sum(_right(r) == len(r["truth"]) == len(r["said"]["effects"]) for r in own)
    return lines.share("two or three effects", "the whole set right", hits, len(own))


def _at_most(value: float) -> tuple[float, float]:
    return -np.inf, value


def _at_least(value: float) -> tuple[float, float]:
    return value, np.inf


CLAIMS = (
    Claim(_false_alarms, _at_most(0.05), _at_most(0.02)),
    Claim(_detected, _at_least(0.90), _at_least(0.98)),
    Claim(
        partial(_named, APART, HIGHEST),
        _at_least(0.95),
        _at_least(0.98),
        partial(_ceiling, APART, HIGHEST),
    ),
    Claim(partial(_named, *WEAK), _at_least(0.75), _at_least(0.88), partial(_ceiling, *WEAK)),
    Claim(partial(_sets, "pair", 0.0), _at_least(0.80), _at_least(0.92)),
    Claim(partial(_sets, "triple", 0.0), _at_least(0.65), _at_least(0.82)),
    Claim(_sides, _at_least(0.95), _at_least(0.99)),
    Claim(partial(_sited, ("electrodes",), 0.0), _at_least(0.93), _at_least(0.99)),
    Claim(_errors, _at_most(2.0), _at_most(1.3)),
    Claim(_coverage, (0.75, 0.98), (0.85, 0.95)),
    Claim(_closed, _at_least(0.85), _at_least(0.97)),
    Claim(_chi2, _at_most(1.3), (0.95, 1.10)),
    Claim(_boxes, _at_least(2.0), _at_least(4.0)),
    Claim(_auroc, _at_least(0.90), _at_least(0.96)),
    Claim(partial(_flagged, 0.0), _at_least(0.70), _at_least(0.88)),
    Claim(_seconds, _at_most(120.0), _at_most(30.0)),
)
# What the table does not ask for and a reader may.
BESIDE = (
    Claim(_decoys),
    Claim(_decoys_named),
    Claim(
        partial(_named, SHOWN, APART),
        ceiling=partial(_ceiling, SHOWN, APART),
    ),
    Claim(partial(_sets, "pair", APART)),
    Claim(partial(_sets, "triple", APART)),
    Claim(_all_right),
    Claim(partial(_sited, ("electrodes",), APART)),
    Claim(partial(_sited, ("electrodes", "drives", "measures", "channels"), 0.0)),
    Claim(partial(_flagged, APART)),
    Claim(_falsely_flagged),
    Claim(_within),
    Claim(_broken),
)
REAL = (Claim(_planted), Claim(_seconds), Claim(_broken))


def table(rows: list[dict], claims: tuple[Claim, ...]) -> pd.DataFrame:
    """One line (LINE) a claim."""
    return pd.DataFrame([_line(rows, claim) for claim in claims], columns=list(LINE))


def _line(rows: list[dict], claim: Claim) -> dict:
    line = claim.measure(rows)
    asked = {"ceiling": np.nan if claim.ceiling is None else claim.ceiling(rows)}
    for key, wanted in (("gate", claim.gate), ("target", claim.target)):
        made = lines.line(line["of"], line["what"], line["value"], 0, 0, line["n"], wanted)
        asked |= {key: made["wanted"], f"{key}_met": made["met"]}
    return {**line, **asked}


def strata(rows: list[dict]) -> dict[str, list[dict]]:
    """The rows by what makes them: `generator: …`, `kind: …`, `gap wanted: …`."""
    made: dict[str, list[dict]] = {}
    for key, text in (("generator", "generator"), ("group", "kind"), ("strength", "gap wanted")):
        values = sorted({row[key] for row in rows if row[key] is not None})
        for value in values:
            shown = value if isinstance(value, str) else f"{value:g}"
            made[f"{text}: {shown}"] = [row for row in rows if row[key] == value]
    return made


def whole(rows: list[dict]) -> pd.DataFrame:
    """Every line (rows, then LINE) of all rows and of each stratum that has any."""
    made = []
    for name, own in {"all": rows, **strata(rows)}.items():
        real = _of("real", own)
        told = table([row for row in own if row not in real], CLAIMS + BESIDE)
        if real:
            told = pd.concat([told, table(real, REAL[:1] if len(real) < len(own) else REAL)])
        made.append((told if name == "all" else told[told["n"] > 0]).assign(rows=name))
    joined = pd.concat(made, ignore_index=True)
    return joined[["rows", *LINE]]


def by_method(rows: list[dict]) -> pd.DataFrame:
    """One line a method: false alarms on nulls, singles' right names and F1 of sets, where it
    names; misfit closed, times its RMSE is ours, and χ² beyond noise, medians over effects."""
    made = []
    for method in METHODS:
        own = [_as_said_by(row, method) for row in rows]
        naming = method == "eitskin" or method in baselines.NAMING
        line = {"method": method, **_naming(own if naming else [])}
        there = _with_effects(rows)
        closed = np.array([misfit_closed(row["hidden"], method) for row in there])
        times = np.array([r["hidden"][method] / r["hidden"]["eitskin"] for r in there])
        for key, values in (("misfit_closed", closed), ("rmse_over_ours", times)):
            told = _median("", "", values)
            line |= {key: told["value"], f"{key}_low": told["low"], f"{key}_high": told["high"]}
        made.append(line | {"effects": len(there)})
    return pd.DataFrame(made)


def _as_said_by(row: dict, method: str) -> dict:
    if method == "eitskin":
        return row
    said = {**SAID_NOTHING, "effects": row["baselines"].get(method) or []}
    return {**row, "said": said}


def _naming(rows: list[dict]) -> dict:
    nulls, alone = _of("null", rows), _of("single", rows)
    right = score.effects(alone)["right"] if alone else np.zeros(0)
    shares = {
        "false_alarms": (sum(bool(r["said"]["effects"]) for r in nulls), len(nulls)),
        "right_name": (int(right.sum()), len(alone)),
    }
    made: dict[str, float] = {}
    for key, (hits, n) in shares.items():
        told = lines.share("", "", hits, n)
        made |= {key: told["value"], f"{key}_low": told["low"], f"{key}_high": told["high"]}
    for kind in ("single", "pair", "triple"):
        told = set_f1(_of(kind, rows), "", "")
        made |= {f"f1_{kind}": told["value"], f"f1_{kind}_low": told["low"]}
        made |= {f"f1_{kind}_high": told["high"]}
    return made


def by_gap(rows: list[dict]) -> pd.DataFrame:
    """Single effects by method and gap wanted: mean gap reached, n, right names with their
    interval, and the mean of Φ(gap / 2)."""
    alone = [row for row in _of("single", rows) if np.isfinite(smallest_gap(row))]
    made = []
    for method in ("eitskin", *baselines.NAMING):
        for strength in sorted({row["strength"] for row in alone}):
            own = [_as_said_by(r, method) for r in alone if r["strength"] == strength]
            gaps = np.array([smallest_gap(row) for row in own])
            right = int(score.effects(own)["right"].sum())
            told = lines.share("", "", right, len(own))
            head = {"method": method, "strength": strength, "gap": float(np.median(gaps))}
            made.append(
                {
                    **head,
                    "n": len(own),
                    "right": told["value"],
                    "low": told["low"],
                    "high": told["high"],
                    "ceiling": float(norm.cdf(0.5 * gaps).mean()),
                }
            )
    columns = ["method", "strength", "gap", "n", "right", "low", "high", "ceiling"]
    return pd.DataFrame(made, columns=columns)


def closed(rows: list[dict]) -> pd.DataFrame:
    """One line a case with an effect and a method: the misfit closed on hidden frames."""
    made = [
        {
            "case": row["case"],
            "method": method,
            "misfit_closed": misfit_closed(row["hidden"], method),
        }
        for row in rows
        if row["truth"]
        for method in METHODS
        if method not in ("none", "oracle")
    ]
    return pd.DataFrame(made, columns=["case", "method", "misfit_closed"])
