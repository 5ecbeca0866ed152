"""Exact equivalents: readings that two causes share, and what an owner checks to tell them apart.

An effect's `identities` say that there is another cause of the same readings. That cause is
simulated at the values that follow from those of the effect, and the gap is measured in the
recording's own noise: an identity of untouched frames, say, breaks where touches have known places,
and is not declared there. No identity needs more causes than one on its other side: a rim of any
shape is also a pattern of electrode angles on a circle, but each of them would have to be off by
itself. Nor has the catalogue a name for every cause: a load cell or a gain that drifts is described
in words alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.estimates import estimates
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.search.explanation import Explanation
from eitskin.diagnose.search.gates import DISTINCT
from eitskin.diagnose.search.refits import linearised, reduced
from eitskin.diagnose.search.screen import explained_square, sparse
from eitskin.diagnose.search.search import Search
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Moment, Setting, SkinEffect
from eitskin.effects.identity import Identity, NamedEffect, OtherSide, Substitute
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import rim_numbers
from eitskin.physics.skin import Skin

PLACE = "electrode-position"  # that of every electrode, which may follow the other side


@dataclass(frozen=True)
class FittedEffect:
    """Effect `index` of an explanation, as `NamedEffect` says."""

    search: Search
    explanation: Explanation
    index: int

    @property
    def candidate(self) -> Candidate:
        """The effect at its sites."""
        return self.explanation.effects[self.index]

    @property
    def model(self) -> RecordingSimulator:
        """The recording's simulator."""
        return self.explanation.fit.problem.model

    @property
    def calibration(self) -> np.ndarray:
        """(P,): coordinates of the calibrations."""
        return self.explanation.fit.theta[: len(self.model.calibrations)]

    @property
    def coordinates(self) -> np.ndarray:
        """(size,): indices of its coordinates in theta."""
        place = self.explanation.fit.coordinate_slice(self.index)
        return np.arange(place.start, place.stop)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.name

    @property
    def scope(self) -> str:
        """Whether it is sparse, dense or common."""
        return self.candidate.scope

    @property
    def kind(self) -> str | None:
        """Kind of its sites."""
        return self.candidate.kind

    @property
    def sites(self) -> tuple[int, ...]:
        """Its sites."""
        return self.candidate.site_indices

    @property
    def values(self) -> dict[str, Any]:
        """Its parameters as fitted."""
        return self.explanation.fit.settings()[self.index].values

    @property
    def skin(self) -> Skin:
        """The skin as calibrated, without effects."""
        return self.model.skin(self.calibration)

    @property
    def geometry(self) -> Geometry:
        """The skin with all effects, untouched, at the start."""
        return self.model.geometry(self.calibration, self.explanation.fit.settings())

    @property
    def electrodes(self) -> np.ndarray:
        """(n,): numbers of the electrodes."""
        angles = self.model.nominal_skin.electrode_deg
        assert angles is not None
        return np.arange(len(angles))

    @property
    def channels(self) -> np.ndarray:
        """(M, 4): source, sink, plus and minus of every channel."""
        return self.model.channels

    @property
    def time_s(self) -> np.ndarray:
        """(N,): times of the frames."""
        return self.model.states["time_s"].to_numpy(float)

    @property
    def force_N(self) -> np.ndarray:
        """(N,): forces as reported."""
        return self.model.states["force_N"].to_numpy(float)

    def interval(self, key: str) -> tuple[float, float]:
        """90 % interval of a parameter."""
        estimate = estimates(self.explanation.fit, self.index)[key]
        return estimate["low"], estimate["high"]

    def partners(self, names: Sequence[str]) -> list["FittedEffect"]:
        """Effects of other names, of these, beside it."""
        return [
            replace(self, index=index)
            for index, candidate in enumerate(self.explanation.effects)
            if candidate.name in names and candidate.name != self.name
        ]

    def simulated(
        self,
        substitutes: Sequence[Substitute] = (),
        omitted: Sequence[str] = (),
        conductivity_ratio: float | None = None,
        force_N: np.ndarray | None = None,
    ) -> np.ndarray:
        """(N, M): readings with substitutes in its place and in place of the effects that are
        omitted, with the conductivity times a ratio, and with other forces (N,)."""
        settings = [
            setting
            for index, setting in enumerate(self.explanation.fit.settings())
            if index != self.index and setting.effect.name not in omitted
        ]
        if conductivity_ratio is not None:
            settings.append(Setting(_Conductivity(), None, {"ratio": conductivity_ratio}))
        settings += map(substitute_setting, substitutes)
        model = self.model
        if force_N is not None:
            model = model.with_displacements({"force_N": force_N - self.force_N})
        return model.voltage(self.calibration, settings)

    def gap(self, voltage: np.ndarray, electrodes_follow: bool = False) -> float:
        """Length, in noise units, of what readings (N, M) have beyond those of the fit, to first
        order, when calibrations and the other effects follow; electrodes_follow: or all that is
        fitted and the place of every electrode on the rim."""
        fitted = self.explanation.fit
        simulated = self.model.voltage(self.calibration, fitted.settings())
        change = fitted.problem.whitening(voltage - simulated).ravel()
        skin, scales = self.candidate.skin, self.candidate.scales
        sites = tuple(rim_numbers(skin, len(self.electrodes)).tolist())
        if electrodes_follow and sites:
            places = Candidate(EFFECTS[PLACE], "electrodes", sites, "dense", {}, skin, scales)
            tangents = Tangents(fitted, reversed(self.search.cache.tangents.values()))
            change = tangents.marginal(change.reshape(tangents.voltage.shape)).ravel()
            change, columns = tangents.project_out(change), tangents.columns(places)
        else:
            columns = np.delete(fitted.jacobian, self.coordinates, axis=0)
            columns = columns.reshape(len(columns), -1)
        followed = explained_square(columns, change)[0] if len(columns) else 0.0
        return float(np.sqrt(max(change @ change - followed, 0.0)))

    def fitted_substitute(self, name: str, displacement: complex) -> tuple[dict[str, Any], float]:
        """Parameters of another effect, without sites and with `polar` parameters, fitted in its
        place; and the gap that remains to it and to its own other sides.

        displacement: where the fit starts, as of the polar parameters: the size (its logarithm
        where it stays above 0) times exp(i m angle).
        """
        effect, fitted = EFFECTS[name], self.explanation.fit
        assert effect.polar is not None
        skin, scales = self.candidate.skin, self.candidate.scales
        substitute = Candidate(effect, None, None, "", {}, skin, scales)
        start = displacement / scales.typical_change(effect.parameters[effect.polar[0]])
        effects = [c for i, c in enumerate(self.explanation.effects) if i != self.index]
        theta = np.r_[np.delete(fitted.theta, self.coordinates), start.real, start.imag]
        target = replace(fitted.problem, readings=fitted.voltage())
        best_fit = fit(target, [*effects, substitute], theta, polish=True)
        explanation = replace(self.explanation, fit=best_fit)
        named = FittedEffect(self.search, explanation, len(effects))
        sides = [identity.other_side(named) for identity in effect.identities]
        gaps = [float(np.sqrt(best_fit.chi2)), *(side.gap for side in sides if side is not None)]
        return best_fit.settings()[-1].values, max(gaps)

    def is_distinct(self, gap: float) -> bool:
        """Whether causes with such a gap are distinguishable."""
        return DISTINCT.admits(gap)

    def equality_gap(self, partner: NamedEffect, order: Sequence[int]) -> float:
        """Mahalanobis distance of its coordinates from those of a partner, in this order."""
        assert isinstance(partner, FittedEffect)
        fitted = self.explanation.fit
        places, partner_places = self.coordinates, partner.coordinates[order]
        difference = fitted.theta[places] - fitted.theta[partner_places]
        contrast = np.zeros((len(difference), len(fitted.theta)))
        contrast[range(len(difference)), places] = 1.0
        contrast[range(len(difference)), partner_places] = -1.0
        covariance = contrast @ fitted.covariance @ contrast.T
        return float(np.sqrt(difference @ np.linalg.solve(covariance, difference)))

    def gap_without(
        self, partner: NamedEffect, names: Sequence[str], electrodes: Sequence[int]
    ) -> float:
        """Length, in noise units, of what it and a partner change together beyond effects with
        these names, free at each of some electrodes; to first order."""
        assert isinstance(partner, FittedEffect)
        search, fitted = self.search, self.explanation.fit
        rest = self.explanation
        for index in sorted((self.index, partner.index), reverse=True):
            rest = reduced(search, rest, index)
        tangents = linearised(search, rest)
        simulated = self.model.voltage(self.calibration, fitted.settings())
        change = rest.fit.problem.whitening(simulated - tangents.voltage).ravel()
        whitened = tangents.marginal(change.reshape(tangents.voltage.shape))
        signature = tangents.project_out(whitened.ravel())
        everywhere = [*search.candidates, *search.family_members]
        dense = [c for c in everywhere if c.name in names and c.scope == "dense"]
        columns = np.concatenate([tangents.columns(sparse(c, tuple(electrodes))) for c in dense])
        gain, _ = explained_square(columns, signature)
        return float(np.sqrt(max(signature @ signature - gain, 0.0)))


class _Conductivity(SkinEffect):
    """sigma * ratio: a calibration's, and so no name; another side may need it."""

    name = "conductivity"
    driver = "static"

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        sigma_S_per_m = geometry.conductivity_S_per_m * setting.values["ratio"]
        return geometry.with_values(conductivity_S_per_m=sigma_S_per_m)


def substitute_setting(substitute: Substitute) -> Setting:
    """The effect that a substitute names, at its values."""
    effect = EFFECTS[substitute.name]
    return Setting(effect, substitute.sites, substitute.values, substitute.kind)


def other_sides(
    search: Search, explanation: Explanation, index: int
) -> list[tuple[Identity, OtherSide]]:
    """The identities of effect `index` of an explanation that speak of it, each with its other
    side; their names without those that the recording's catalogue does not have."""
    catalogue = {candidate.name for candidate in search.candidates}
    sides = []
    for identity in explanation.effects[index].effect.identities:
        try:
            side = identity.other_side(FittedEffect(search, explanation, index))
        except (InputError, np.linalg.LinAlgError):
            continue  # the physics has no such skin
        if side is not None:
            names = tuple(name for name in identity.names if name in catalogue)
            sides.append((replace(identity, names=names), side))
    return sides


def sentences(
    search: Search, explanation: Explanation, index: int, alternatives: list[str]
) -> list[str]:
    """What effect `index` of an explanation may be as well, in sentences that an owner can check:
    the other sides below DISTINCT, and those that have a name among its alternatives."""
    return [
        side.sentence
        for identity, side in other_sides(search, explanation, index)
        if side.sentence and (not DISTINCT.admits(side.gap) or {*identity.names} & {*alternatives})
    ]


def is_two_sided(name: str) -> bool:
    """Whether a name does not stand, even as another's alternative, without its other side."""
    return any(identity.names and not identity.of_pair for identity in EFFECTS[name].identities)
