"""What a comparison tests, and what it finds."""

from dataclasses import dataclass, field

from eitskin.diagnose.comparison.joint import (
    Shared,
)
from eitskin.diagnose.fitting.held_out import HeldOut


@dataclass(frozen=True)
class Tested:
    """One value, or one polar pair of values, tested for equality over the parts that have it.

    effect: its place among all, CALIBRATED for a calibration; keys: names of its parameters; site:
    of its kind, or None; chi2, dof, p, q: None where fewer than two parts have it; groups: runs of
    parts that share one value, one where nothing changed; values: of every part by its own fit,
    combined: of every group, each {parameter: {value, low, high, unit}}, empty for an effect that
    is there or not; there: for such an effect, whether each part has it.
    """

    effect: int
    keys: tuple[str, ...]
    site: int | None
    chi2: float | None
    dof: int | None
    p: float | None
    q: float | None
    groups: list[tuple[str, ...]]
    values: dict[str, dict] = field(default_factory=dict)
    combined: list[dict] = field(default_factory=list)
    there: dict[str, bool] = field(default_factory=dict)
    sentence: str = ""

    @property
    def changed(self) -> bool:
        """Whether the parts do not share it."""
        return len(self.groups) > 1


@dataclass(frozen=True)
class Comparison:
    """Parts of one skin compared: their names in order, the effects found in any of them, every
    value tested, and what is predicted for frames left out if all is shared, and as found.

    p_value: of the joint fits' likelihood ratio, all shared against the changes that the tests
    ask for; None where they ask for none.
    """

    names: list[str]
    effects: list[Shared]
    tested: list[Tested]
    p_value: float | None
    all_shared: HeldOut
    as_found: HeldOut
