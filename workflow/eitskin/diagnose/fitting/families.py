"""The members of families: one effect at every site, and what they do to the readings of a fit."""

from collections.abc import Mapping

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.families import Family

# Derivatives of all readings by all members, that a diagnosis holds at most: 160 frames of 16
# electrodes, 18 of 32. More take minutes and gigabytes.
MOST_DERIVATIVES = 4_000_000
# Of a recording with touches, whose fits have the members among their calibrations: 240 frames of
# 16 electrodes with adjacent drives.
MOST_TOUCHED_DERIVATIVES = 6_000_000
LEAST_CHANGE = 1e-7  # of the readings, by a typical change of all members: less is rounding


def members(candidates: list[Candidate]) -> dict[str, tuple[Candidate, ...]]:
    """The candidates of a catalogue that are the members of each family that it has, by name."""
    families = {
        name: tuple(c for c in candidates if _is_member(c, family))
        for name, family in COMPONENTS.items()
        if isinstance(family, Family)
    }
    return {name: family for name, family in families.items() if family}


def most_frames(
    families: Mapping[str, tuple[Candidate, ...]], channel_count: int, touched: bool
) -> int:
    """The number of frames of so many channels to which families are fitted at most; touched:
    whether in some of them somebody touches."""
    most = MOST_TOUCHED_DERIVATIVES if touched else MOST_DERIVATIVES
    return most // (channel_count * sum(c.size for family in families.values() for c in family))


def family_name(candidate: Candidate) -> str:
    """The name of the family that a candidate is a member of."""
    return next(
        name
        for name, family in COMPONENTS.items()
        if isinstance(family, Family) and _is_member(candidate, family)
    )


def _is_member(candidate: Candidate, family: Family) -> bool:
    scope = "dense" if family.sites else ""
    return (
        candidate.name == family.effect
        and candidate.kind == family.sites
        and candidate.scope == scope
        and candidate.start in family.starts
    )


def family_columns(
    tangents: Tangents, families: Mapping[str, tuple[Candidate, ...]]
) -> dict[str, np.ndarray]:
    """(K, N, M) by family: derivatives of the readings by the coordinates of its members; families
    whose members change less than LEAST_CHANGE have none."""
    voltage, nothing = tangents.voltage, np.zeros_like(tangents.voltage)
    columns = {}
    for name, candidates in families.items():
        raw = [column for c in candidates for column in tangents.raw_columns(c)]
        by_member = np.array(
            [nothing if column is None else column.reshape(voltage.shape) for column in raw], float
        )
        if np.linalg.norm(by_member) > LEAST_CHANGE * np.linalg.norm(voltage):
            columns[name] = by_member
    return columns
