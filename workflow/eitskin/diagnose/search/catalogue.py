"""Which effects are sought in a recording: the catalogue at every site, by what is known of it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate, Scales
from eitskin.diagnose.search.gates import COMPOSED, CONTACTS, FLOATING, MODELLED, STATED, TIMED
from eitskin.diagnose.search.journal import Journal
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect
from eitskin.physics.skin import Skin


@dataclass(frozen=True)
class Conditions:
    """What decides which effects are sought.

    owner: the skin as its owner believes it, None where unknown; skin: with a start for what is
    unknown; site_counts: how many sites there are of each kind; floating: the source is tied to
    nothing; timed: the times of the frames were measured; touched: somebody touches.
    """

    owner: Skin
    skin: Skin
    site_counts: dict[str, int]
    floating: bool
    timed: bool
    touched: bool = True


def catalogue(
    conditions: Conditions, recorded_V: np.ndarray, scales: Scales, journal: Journal | None = None
) -> list[Candidate]:
    """Every candidate: single sites, pairs where an effect needs two, all alike, each its own.

    recorded_V (N, M): from which some effects start; journal: records which effects are not sought.
    Single channels stand in their dense form alone: `channels` takes it apart.
    """
    journal = journal or Journal()
    owner, skin = conditions.owner, conditions.skin
    candidates = []
    for effect in EFFECTS.values():
        if not _is_sought(effect, conditions, journal):
            continue
        for start in effect.starts(replace(skin, thickness_mm=owner.thickness_mm), recorded_V):
            for kind, sites, scope in _sites(effect, conditions):
                candidates.append(Candidate(effect, kind, sites, scope, start, skin, scales))
    looks: dict[str, int] = {}
    for candidate in candidates:
        looks[candidate.name] = looks.get(candidate.name, 0) + 1
    return [replace(c, looks=looks[c.name]) for c in candidates]


def _is_sought(effect: Effect, conditions: Conditions, journal: Journal) -> bool:
    """Whether an effect is sought; the gate at which it stops is recorded."""
    skin = conditions.skin
    has_contacts = skin.electrode_width_mm != 0 or not getattr(effect, "on_contacts", False)
    for gate, holds in (
        (COMPOSED, not effect.composite),
        (CONTACTS, has_contacts),
        (MODELLED, effect.is_modelled(skin)),
        (STATED, effect.is_stated(skin, conditions.touched)),
        (TIMED, conditions.timed or effect.driver != "time"),
        (FLOATING, conditions.floating or not effect.last_resort),
    ):
        if not journal.would_pass(gate, holds, effect.name):
            return journal.judge(gate, holds, effect.name)
    return True


def _sites(
    effect: Effect, conditions: Conditions
) -> Iterator[tuple[str | None, tuple[int, ...] | None, str]]:
    """(kind, sites, scope) of every candidate of an effect."""
    if not effect.sites:
        yield None, None, ""
        return
    at_once = effect.sites_at_once(conditions.floating)
    kinds = effect.sites[:1] if at_once > 1 else effect.sites
    for kind in kinds:
        if kind != "channels":
            for sites in combinations(range(conditions.site_counts[kind]), at_once):
                yield kind, sites, "sparse"
    if not effect.parameters or effect.site_number:
        return
    for kind in kinds:
        for everywhere in effect.site_groups(conditions.skin, kind, conditions.site_counts[kind]):
            yield kind, everywhere, "dense"
            if effect.common:
                yield kind, everywhere, "common"
