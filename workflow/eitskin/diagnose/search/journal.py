"""What a search did and decided: its steps, and each value that a gate let pass or refused."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass, field, fields

import pandas as pd

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import Gate

START = "start"  # the step of an effect that was there before the search began
CUT_SHORT = "cut short"  # the step that says that the budget was used up
UNLIKE_STEP = "unlike"  # the step that says that the readings are of no such skin


@dataclass(frozen=True)
class Decision:
    """One value held against one gate.

    round: counts the times that candidates are tried beside a set, or a set is pruned; beside: the
    names of the set beside which the candidate was judged, in its order; place: the name whose
    place it would take, "" where it would be one more; kind, sites: "" where it has none; detail:
    a sentence on the candidate itself, where the value is of the whole search.
    """

    round: int
    name: str
    kind: str
    sites: str
    gate: str
    value: float
    admitted: bool
    beside: str
    place: str
    detail: str


@dataclass(frozen=True)
class Refusal:
    """Why a candidate was not fitted: the gate and the value that it had there."""

    gate: Gate
    value: float


@dataclass
class Journal:
    """The steps and decisions of one search, in their order; opened: pairs of a gate's name and an
    effect's, for which the gate lets everything pass, so that one can ask what if."""

    opened: frozenset[tuple[str, str]] = frozenset()
    steps: list[dict] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    round: int = 0

    def begin_round(self) -> None:
        """Count another round."""
        self.round += 1

    def judge(
        self,
        gate: Gate,
        value: float,
        candidate: Candidate | str,
        explanation: Explanation | None = None,
        place: str = "",
        detail: str = "",
    ) -> bool:
        """Record a value held against a gate beside an explanation; return whether it passes."""
        name = candidate if isinstance(candidate, str) else candidate.name
        admitted = self.would_pass(gate, value, name)
        beside = "" if explanation is None else " ".join(c.name for c in explanation.effects)
        kind = "" if isinstance(candidate, str) else candidate.kind or ""
        sites = sites_text(candidate)
        judgement = gate.name, float(value), admitted, beside, place, detail
        self.decisions.append(Decision(self.round, name, kind, sites, *judgement))
        return admitted

    def judge_any(
        self,
        values: Iterable[tuple[Gate, float]],
        candidate: Candidate | str,
        explanation: Explanation | None = None,
        detail: str = "",
    ) -> bool:
        """Record several gates, each with a value, of which one must let a candidate pass; return
        whether one does. Where none does all are recorded, else the first that does."""
        values = list(values)
        name = candidate if isinstance(candidate, str) else candidate.name
        passed = [pair for pair in values if self.would_pass(*pair, name)]
        for gate, value in passed[:1] or values:
            self.judge(gate, value, candidate, explanation, detail=detail)
        return bool(passed)

    def would_pass(self, gate: Gate, value: float, name: str) -> bool:
        """Whether a gate lets a value pass, or is opened for a name; not recorded."""
        return gate.admits(value) or (gate.name, name) in self.opened

    def step(
        self,
        action: str,
        effect: Candidate | None,
        explanation: Explanation,
        p_value: float | None = None,
    ) -> None:
        """Record what was done with an effect, and the explanation after it."""
        self.steps.append(
            {
                "step": len(self.steps),
                "action": action,
                "effect": effect.name if effect else "",
                "sites": sites_text(effect) if effect else "",
                "chi2": explanation.fit.chi2,
                "log_evidence": explanation.log_evidence,
                "p_value": p_value,
            }
        )

    def table(self) -> pd.DataFrame:
        """The decisions, one a row."""
        columns = [field.name for field in fields(Decision)]
        return pd.DataFrame([astuple(decision) for decision in self.decisions], columns=columns)


def sites_text(candidate: Candidate | str) -> str:
    """The numbers of a candidate's sites, "" where it has none."""
    sites = None if isinstance(candidate, str) else candidate.sites
    return " ".join(map(str, sites)) if sites else ""
