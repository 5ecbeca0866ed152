"""One search: what is asked, what may be spent, what was computed, what was decided."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import Fit, Problem
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.noise.scoring import ScoringCache
from eitskin.diagnose.search import far_starts
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import BUDGET
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.screen import NullDistribution, Score
from eitskin.physics.geometry import Geometry

MOST_SOLVED = 16_000  # sheets that one diagnosis may solve: some minutes on one core


@dataclass
class Cache:
    """What a search computed, by the keys of sets of effects.

    tangents: about a set; met: the explanation that the tangents of a set are about; reduced: sets
    less one effect, with the fit of the whole set; scores, trials: beside a set, with its fit;
    lengths: squared length of the change by each candidate without coordinates; lacks: nats by
    which each name was behind that no tangent leads to; scoring: of the sds of the rig's errors;
    null: distribution of the least p-value by chance alone.
    """

    tangents: dict[tuple, Tangents] = field(default_factory=dict)
    met: dict[tuple, Explanation] = field(default_factory=dict)
    reduced: dict[tuple, tuple[Fit, Explanation]] = field(default_factory=dict)
    scores: dict[tuple, tuple[Fit, list[Score]]] = field(default_factory=dict)
    trials: dict[tuple, tuple[Fit, list[Explanation]]] = field(default_factory=dict)
    lengths: dict[tuple, float] = field(default_factory=dict)
    lacks: dict[str, float] = field(default_factory=dict)
    scoring: ScoringCache = field(default_factory=ScoringCache)
    null: NullDistribution | None = None

    def branch(self) -> "Cache":
        """A cache for a search among other candidates: what was fitted is shared, scores and
        trials are not."""
        return replace(
            self,
            tangents=dict(self.tangents),
            met=dict(self.met),
            reduced=dict(self.reduced),
            scores={},
            trials={},
        )

    def adopt(self, branch: "Cache") -> None:
        """Take over what a branch computed, its scores excepted: they are of fewer candidates."""
        self.tangents, self.met, self.reduced = branch.tangents, branch.met, branch.reduced
        self.trials = branch.trials


@dataclass(frozen=True)
class Search:
    """One recording's search for the effects that explain it.

    problem: with noise alone in its covariance; family_members: with a value at every site, which
    families have in place of candidates; folds: (N,) of frames, or (1, M) of channels where
    nobody touches; seed: of the recordings in which nothing is missing; report: called with a line
    of progress; last_resorts: candidates that are tried where the readings are not those of the
    skin; budget_share: of all that a diagnosis may solve; learns_rig: whether errors of the rig may
    add to the covariance; converter_step: of the readings, 0 where unknown; rig: its errors,
    linearised about the calibrated fit, once the search has ended about the final one; unblurred:
    problem and rig before `last_resorts.blurred`, where the search is in that noise;
    rival_evidence: log evidence that a set must reach to matter; has_body: whether effects that
    candidates are tried beside may make a body of the sheet.
    """

    problem: Problem
    candidates: list[Candidate]
    folds: np.ndarray
    seed: int
    report: Callable[[str], None]
    last_resorts: list[Candidate] = field(default_factory=list)
    family_members: list[Candidate] = field(default_factory=list)
    budget_share: float = 1.0
    learns_rig: bool = False
    converter_step: float = 0.0
    rig: RigErrors | None = None
    unblurred: tuple[Problem, RigErrors | None] | None = None
    rival_evidence: float = -np.inf
    has_body: bool = False
    cache: Cache = field(default_factory=Cache, repr=False)
    journal: Journal = field(default_factory=Journal, repr=False)

    @property
    def budget(self) -> float:
        """Sheets after which nothing more is tried for its own sake."""
        return self.budget_share * MOST_SOLVED

    @property
    def spent(self) -> bool:
        """Whether the budget is used up, so that the search ends with what it has."""
        return not BUDGET.admits(self.budget_used)

    @property
    def budget_used(self) -> float:
        """Sheets solved so far over the budget."""
        effort = self.problem.model.solved_skins.effort
        return effort / self.budget if self.budget else float(np.inf if effort else 0.0)

    @property
    def untouched(self) -> bool:
        """Whether nobody touches: folds are of channels then."""
        return self.folds.ndim == 2

    @property
    def tries_bodies(self) -> bool:
        """Whether some candidate makes a body of the sheet, or an effect may have done so."""
        return self.has_body or bool(self.bodies)

    @property
    def bodies(self) -> list[Candidate]:
        """The candidates that make a body of the sheet."""
        sheet = self._sheet
        return [c for c in self.candidates if c.effect.largest_body(sheet) is not None]

    def is_body(self, candidate: Candidate) -> bool:
        """Whether a candidate makes a body of the sheet."""
        return candidate.effect.largest_body(self._sheet) is not None

    @property
    def _sheet(self) -> Geometry:
        return Geometry.from_skin(self.problem.model.nominal_skin)

    def starts_far(self, candidate: Candidate) -> bool:
        """Whether no tangent leads to a candidate, so that its fits begin at `far_starts`."""
        return self.untouched and far_starts.is_far(candidate)

    def in_covariance(self, problem: Problem, rig: RigErrors | None) -> "Search":
        """The same search in another covariance, without what was computed in this one."""
        cache = Cache(null=self.cache.null)
        return replace(self, problem=problem, rig=rig, cache=cache)

    def restored(self) -> "Search":
        """The search in the noise before `last_resorts.blurred`; itself where it is in no other."""
        if self.unblurred is None:
            return self
        return replace(self.in_covariance(*self.unblurred), unblurred=None)
