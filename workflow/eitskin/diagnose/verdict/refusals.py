"""Why a name is not among the effects of a diagnosis: the gate at which it stopped."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from eitskin.diagnose.search import gates
from eitskin.diagnose.search.gates import SITES, Gate
from eitskin.diagnose.verdict.words import is_certain
from eitskin.effects import catalogue_names
from eitskin.errors import InputError
from eitskin.quantities import listed

FILE = "decisions.csv"  # of the evidence beside diagnosis.json
NOUNS = {"electrodes": "electrode", "drives": "drive", "measures": "pair", "channels": "channel"}
BY_NAME = {gate.name: gate for gate in gates.every()}
ORDER = {name: rank for rank, name in enumerate(BY_NAME)}


@dataclass(frozen=True)
class Stop:
    """The gate at which a name stopped.

    kind, sites: of the candidate that came furthest; value: of the gate's statistic; beside: the
    effects beside which it was judged; place: the effect whose place it would have taken, or "";
    detail: on the candidate itself, or "".
    """

    name: str
    sites: str
    gate: Gate
    value: float
    kind: str
    beside: tuple[str, ...]
    place: str
    detail: str

    @property
    def sentence(self) -> str:
        """What stopped the name, in words."""
        text = self.gate.refusal_text(self.value, self.place)
        sites = f" at {_sites_text(self.kind, self.sites)}" if self.sites else ""
        beside = f"beside {listed(list(self.beside))}, " if self.beside else ""
        detail = f"; {self.detail}" if self.detail else ""
        return f"{self.name}{sites} stopped at {self.gate.name}: {beside}{text}{detail}."


def read(folder: Path) -> tuple[dict, pd.DataFrame]:
    """The content of diagnosis.json in a folder, and the decisions of its search, one a row; raises
    InputError where the folder has none."""
    path = folder / "evidence" / FILE
    for file in (folder / "diagnosis.json", path):
        if not file.is_file():
            expected = "the folder of a diagnosis of this version"
            raise InputError(folder, str(file.relative_to(folder)), "no such file", expected)
    texts = ("kind", "sites", "beside", "place", "detail")
    decisions = pd.read_csv(path, dtype=dict.fromkeys(texts, str))
    decisions[[*texts]] = decisions[[*texts]].fillna("")
    return json.loads((folder / "diagnosis.json").read_text(encoding="utf-8")), decisions


def stop(decisions: pd.DataFrame, effects: Sequence[str], name: str) -> Stop | None:
    """Where a name stopped that is not among the effects of a diagnosis; None where it was never
    held against a gate.

    decisions: of the search, one a row; effects: the names of the diagnosis. What counts is the
    last time that the name was judged as one more effect beside these, else the last time that it
    was judged at all; there the candidate that came furthest, and the first gate that refused it.
    """
    rows = decisions[decisions["name"] == name]
    final = rows[(rows["beside"] == " ".join(effects)) & (rows["place"] == "")]
    for choice in (final, rows):
        refused = choice[~choice["admitted"]]
        if len(refused):
            final_round = refused[refused["round"] == refused["round"].max()]
            stopping = final_round.groupby(["kind", "sites"], sort=False).head(1)
            row = stopping.loc[stopping["gate"].map(ORDER).idxmax()]
            return Stop(
                name,
                row["sites"],
                BY_NAME[row["gate"]],
                float(row["value"]),
                row["kind"],
                tuple(row["beside"].split()),
                row["place"],
                row["detail"],
            )
    return None


def stops(decisions: pd.DataFrame, effects: Sequence[str]) -> list[Stop]:
    """Where every name of the catalogue stopped that is not among the effects of a diagnosis."""
    names = (name for name in sorted(catalogue_names()) if name not in effects)
    candidates = (stop(decisions, effects, name) for name in names)
    return [met for met in candidates if met is not None]


def sentences(decisions: pd.DataFrame, diagnosis: dict, name: str | None = None) -> list[str]:
    """Sentences on every name of the catalogue, or on one.

    diagnosis: the content of diagnosis.json. Raises InputError for a name that is not in the
    catalogue.
    """
    catalogue = sorted(catalogue_names())
    if name is not None and name not in catalogue:
        raise InputError("eitskin explain", "NAME", name, f"one of {', '.join(catalogue)}")
    entries = {entry["name"]: entry for entry in diagnosis["effects"]}
    lines = []
    for effect in catalogue if name is None else [name]:
        if effect in entries:
            lines.append(_named_sentence(entries[effect], decisions))
            continue
        end = stop(decisions, list(entries), effect)
        lines.append(f"{effect} met no gate." if end is None else end.sentence)
    return lines


def _named_sentence(entry: dict, decisions: pd.DataFrame) -> str:
    """Whether a name that is among the effects is certain and, where it is not, why."""
    if is_certain(entry):
        return f"{entry['name']} is named, and certain."
    certainty = [gate.name for gate in gates.every() if gate.purpose == "certainty"]
    rows = decisions[(decisions["name"] == entry["name"]) & ~decisions["admitted"]]
    rows = rows[rows["gate"].isin(certainty)]
    reasons = [BY_NAME[row.gate].refusal_text(row.value, row.place) for row in rows.itertuples()]
    if not reasons:  # an earlier version, without that gate, called it certain
        reasons = [gates.STATED_SIZE.refusal]
    return f"{entry['name']} is named as a candidate: {'; '.join(reasons)}."


def _sites_text(kind: str, sites: str) -> str:
    """Sites in words: `electrode 3`, `channels 4 and 5`, `16 electrodes`."""
    noun = NOUNS.get(kind, "site")
    numbers = sites.split()
    if len(numbers) > SITES.threshold:
        return f"{len(numbers)} {noun}s"
    return f"{noun}{'s' if len(numbers) > 1 else ''} {listed(numbers)}"
