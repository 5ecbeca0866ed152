"""Derivatives of the readings by every candidate about a fit.

Sites are differentiated once; the same columns serve a site alone, all sites with one value and
each with its own. An effect of the skin that scales contact impedances or the conductivity by a law
of the moment has their columns times its law, frame by frame. Any other effect is differenced by
the simulator.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from eitskin import cores
from eitskin.diagnose.fitting.candidates import Candidate, exclusive_channels
from eitskin.diagnose.fitting.fit import STEP, Fit
from eitskin.diagnose.noise.low_rank import BATCH_COLUMNS, LowRankFactor
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect, Setting, SkinEffect
from eitskin.errors import InputError
from eitskin.physics.depth import span
from eitskin.physics.geometry import Geometry
from eitskin.physics.solver import forward_model
from eitskin.simulate.readings import apply_skin

CLOSE_SHARE = 0.03  # of the readings, by which two fits may differ and share their derivatives
MIN_SPREAD = 0.1  # of an electrode's width, by which a contact spreads the current: few modes do
RESIDUAL_SHARE = 1e-12  # of a column's squared length: what is left of a fitted one is rounding
RANK_SHARE = 1e-9  # of the largest singular value of the fitted columns: less is rounding
IMPEDIVITY = "contact_impedivity_ohm_m2"
SCALED_ATTRIBUTES = (IMPEDIVITY, "conductivity_S_per_m")


class Tangents:
    """Whitened derivatives (N M,) by the coordinates of candidates about `fit`, those of the fitted
    coordinates projected out; members of families, which have a prior, are part of the covariance.

    donors: tangents about other fits, whose derivatives are used where their readings are close; a
    score test is valid in any direction, and a fit does not depend on these. Whitened columns are
    stored until `clear_whitened`: a site's column is the same alone, among all sites, and in the
    sum that is the column of one value for all.
    """

    def __init__(self, fit: Fit, donors: "Iterable[Tangents]" = ()):
        self.fit = fit
        self.problem = fit.problem
        self.calibration, self.settings = self.problem.split(fit.theta, fit.effects)
        self.voltage = self.problem.model.voltage(self.calibration, self.settings)
        self.accuracy = self._accuracy()
        self.base_voltage = self.voltage
        if self.accuracy != "diagnose":
            self.base_voltage = self._simulated(self.calibration, self.settings)
        self.members, derivatives = self.problem.model.member_columns
        self.member_factor = None
        residual = fit.residual
        if len(self.members):
            columns = self.problem.whitening(derivatives)
            self.member_factor = LowRankFactor(columns, "whole")
            residual = residual + np.tensordot(fit.theta[self.members], columns, 1)
        self.channel_directions, columns = self._blocks()
        directions, triangle = np.linalg.qr(columns.T)
        rotation, size, _ = np.linalg.svd(triangle)
        nonzero = size > RANK_SHARE * size.max(initial=0.0)
        self.fitted_directions = rotation.T[nonzero] @ directions.T
        self.residual = self.project_out(self.marginal(residual).ravel())
        self.source = self
        for donor in donors:
            if self._is_close_to(donor.source):
                self.source = donor.source
                break
        self._raw_by_key: dict[tuple, np.ndarray | None] = {}
        self._whitened_by_key: dict[tuple, np.ndarray | None] = {}
        self._changes: dict[Any, Any] = {}

    def _accuracy(self) -> str:
        """The accuracy of differences: train for a body, in a tenth of the time, with derivatives
        that differ by 6e-3, and for a sheet where they differ by 1e-3, in two thirds of the time
        (`tests/unit/diagnose/fitting/test_tangents.py`)."""
        geometry = self.problem.model.geometry(self.calibration, self.settings)
        if span(geometry) is not None or geometry.points:
            return "train"
        spread = (geometry.contact_length_mm / geometry.electrode_width_mm).min()
        return "train" if spread >= MIN_SPREAD else "diagnose"

    def _simulated(self, calibration: np.ndarray, settings: list[Setting]) -> np.ndarray:
        """(N, M): readings at the accuracy of differences."""
        return self.problem.model.voltage(calibration, settings, self.accuracy)

    def _difference(self, calibration: np.ndarray, settings: list[Setting]) -> np.ndarray:
        """(N, M): readings of a state close to the fit's, less those of the fit's."""
        return self._simulated(calibration, settings) - self.base_voltage

    def _is_close_to(self, other: "Tangents") -> bool:
        """Whether the readings of another fit differ by less than CLOSE_SHARE."""
        distance = np.linalg.norm(self.voltage - other.voltage)
        return bool(distance < CLOSE_SHARE * np.linalg.norm(other.voltage))

    def _blocks(self) -> tuple[list[np.ndarray], np.ndarray]:
        """Directions (N, M) of the fit's blocks, orthonormal channel by channel, and its other
        columns (k, N M) with these projected out."""
        directions: list[np.ndarray] = []
        for block in self.fit.slopes.blocks:
            column = _without_directions(directions, block.column)
            length = np.linalg.norm(column, axis=0)
            directions.append(column / np.where(length > 0, length, 1.0))
        columns = self.fit.slopes.columns
        if len(self.members):
            is_member = np.isin(self.fit.slopes.column_coordinates, self.members)
            columns = self.marginal(columns[~is_member])
        projected = _without_directions(directions, columns)
        return directions, projected.reshape(len(columns), self.voltage.size)

    def marginal(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M): whitened values in the covariance that the members of families have by their
        priors beside the noise."""
        if self.member_factor is None:
            return whitened
        return self.member_factor.apply(whitened, self.member_factor.inverse_root)

    def change(self, fitted: Fit) -> np.ndarray:
        """(N M,): what the readings of another fit have beyond those of this, whitened, the fitted
        coordinates projected out; members that differ between the two differ by no more than their
        priors let them."""
        change = self.problem.whitening(fitted.voltage() - self.voltage)
        if self.member_factor is not None:
            _, derivatives = self.problem.model.member_columns
            shift = self.fit.theta[self.members] - fitted.theta[self.members]
            change = change + np.tensordot(shift, self.problem.whitening(derivatives), 1)
        return self.project_out(self.marginal(change).ravel())

    def project_out(self, columns: np.ndarray) -> np.ndarray:
        """(..., N M): columns with the span of the fitted coordinates projected out."""
        if self.channel_directions:
            frames = columns.reshape(*columns.shape[:-1], *self.voltage.shape)
            projected = _without_directions(self.channel_directions, frames)
            columns = projected.reshape(columns.shape)
        return columns - (columns @ self.fitted_directions.T) @ self.fitted_directions

    def columns(self, candidate: Candidate) -> np.ndarray:
        """(k, N M): the whitened columns of a candidate, k at most its size: coordinates that
        change nothing to first order have none."""
        columns = [column for column in self.coordinate_columns(candidate) if column is not None]
        return np.array(columns, float).reshape(len(columns), self.residual.size)

    def coordinate_columns(self, candidate: Candidate) -> list[np.ndarray | None]:
        """The whitened columns (N M,) of every linear coordinate, one a site where there are
        several, in single precision; None for coordinates that change nothing."""
        return self._site_columns(candidate, self._whitened_columns)

    def column_count(self, candidate: Candidate) -> int:
        """The length of a candidate's `coordinate_columns`."""
        if candidate.sites is None or self._acts_jointly(candidate):
            return int(candidate.linear.sum())
        return 1 if candidate.scope == "common" else len(candidate.sites)

    def raw_products(self, candidate: Candidate, weights: np.ndarray) -> np.ndarray:
        """(column_count,): inner products of weights (N M,) with the derivatives of the readings by
        every coordinate, neither whitened nor projected."""
        columns = self._site_columns(candidate, self.source._raw_columns)
        return np.array([0.0 if column is None else column @ weights for column in columns])

    def raw_columns(self, candidate: Candidate) -> list[np.ndarray | None]:
        """The derivatives (N M,) of the readings by every linear coordinate, one a site where there
        are several, neither whitened nor projected; None for coordinates that change nothing."""
        self._compute_raw(self._singles(candidate))
        return self._site_columns(candidate, self._raw_columns)

    def precompute(self, candidates: Iterable[Candidate]) -> None:
        """Compute the whitened columns of many candidates at once, faster than one by one."""
        singles = [single for candidate in candidates for single in self._singles(candidate)]
        self.source._compute_raw(singles)
        self._whitened_columns(singles)

    def _compute_raw(self, singles: list[tuple[Candidate, int]]) -> None:
        """Store the raw columns of many coordinates, computed in several processes: in one those of
        an effect, and in one those of all effects that vary from frame to frame, which share
        derivatives."""
        groups: dict[str, list[tuple[Candidate, int]]] = {}
        for candidate, index in singles:
            if (*candidate.key, index) not in self._raw_by_key:
                effect = candidate.effect
                varies = isinstance(effect, SkinEffect) and effect.driver != "static"
                name = "varies" if varies else candidate.name
                groups.setdefault(name, []).append((candidate, index))
        shares = cores.shares(groups.values())
        share_columns = self.problem.model.solved_skins.forked(self._raw_columns, shares)
        for share, columns in zip(shares, share_columns, strict=True):
            for (candidate, index), column in zip(share, columns, strict=True):
                self._raw_by_key[(*candidate.key, index)] = column

    @cached_property
    def single_precision(self) -> Whitening:
        """The fit's whitening in single precision, stored until `clear_whitened`."""
        return self.problem.whitening.single_precision

    def clear_whitened(self) -> None:
        """Free the whitened columns; they are computed anew on demand."""
        self._whitened_by_key.clear()
        vars(self).pop("single_precision", None)

    def _site_columns(self, candidate: Candidate, columns: Callable) -> list[np.ndarray | None]:
        singles = columns(self._singles(candidate))
        if candidate.scope != "common":
            return singles
        per_key = len(singles) // len(candidate.site_indices)
        total: Any = sum(s for s in singles[::per_key] if s is not None)
        return [total if np.any(total) else None]

    def jacobian(self, candidate: Candidate) -> np.ndarray:
        """(size, N, M): whitened derivatives by every coordinate; NaN for those without a column,
        for gains of single channels, which a fit computes in one step, and beside members of
        families, whose covariance the columns have."""
        shape = candidate.size, *self.voltage.shape
        is_exclusive = self._exclusive_channels(candidate) is not None
        if len(self.members) or (candidate.kind == "channels" and is_exclusive):
            return np.broadcast_to(np.nan, shape)
        jacobian = np.full(shape, np.nan)
        columns = self.columns(candidate)
        linear = np.flatnonzero(candidate.linear)
        if len(columns) == len(linear):
            jacobian[linear] = columns.reshape(-1, *self.voltage.shape)
        return jacobian

    def start_change(self, candidate: Candidate) -> np.ndarray | None:
        """(N M,): the whitened change of the readings by a candidate at its start, the fitted
        coordinates projected out; None where the physics has no solution there."""
        setting = candidate.setting(np.zeros(candidate.size))
        try:
            voltage = self.problem.model.voltage(self.calibration, [*self.settings, setting])
        except InputError:
            return None
        change = self.marginal(self.problem.whitening(voltage - self.voltage))
        return self.project_out(change.ravel())

    def _singles(self, candidate: Candidate) -> list[tuple[Candidate, int]]:
        """A candidate of one site and a coordinate for every column of a candidate."""
        if candidate.sites is None or self._acts_jointly(candidate):
            return [(candidate, int(i)) for i in np.flatnonzero(candidate.linear)]
        if len(candidate.sites) > 1:
            self.source._compute_exclusive(candidate)
        return [(_single_site(candidate, site), 0) for site in candidate.sites]

    @staticmethod
    def _acts_jointly(candidate: Candidate) -> bool:
        """Whether the sites of a candidate act only jointly."""
        return candidate.effect.stage == "wiring" and candidate.scope == "sparse"

    def _whitened_columns(self, singles: list[tuple[Candidate, int]]) -> list[np.ndarray | None]:
        """Whitened columns, the fitted coordinates projected out, from the store; None for those
        that change nothing."""
        raw = {(*c.key, i): self.source._raw_column(c, i) for c, i in singles}
        missing = {
            k: column
            for k, column in raw.items()
            if column is not None and k not in self._whitened_by_key
        }
        if missing:
            self._whitened_by_key.update(
                zip(missing, self._whitened([*missing.values()]), strict=True)
            )
        return [self._whitened_by_key.get(key) for key in raw]

    def _whitened(self, raw: list[np.ndarray]) -> list[np.ndarray | None]:
        """Raw columns whitened, the fitted coordinates projected out; None for those in their
        span."""
        whitening = self.single_precision

        def whitened_group(group: list[np.ndarray]) -> list[np.ndarray | None]:
            white = self.marginal(whitening(np.array(group).reshape(-1, *self.voltage.shape)))
            white = white.reshape(len(group), -1).astype(float)
            lengths = [float(column @ column) for column in white]
            projected = zip(self.project_out(white), lengths, strict=True)
            return [
                _stored(column if column @ column > RESIDUAL_SHARE * length else None)
                for column, length in projected
            ]

        groups = [raw[start : start + BATCH_COLUMNS] for start in range(0, len(raw), BATCH_COLUMNS)]
        return [column for group in cores.threaded(whitened_group, groups) for column in group]

    def _raw_columns(self, singles: list[tuple[Candidate, int]]) -> list[np.ndarray | None]:
        return [self._raw_column(candidate, index) for candidate, index in singles]

    def _raw_column(self, candidate: Candidate, index: int) -> np.ndarray | None:
        """(N M,): the derivative by one coordinate in the recording's unit, in single precision;
        None where nothing changes."""
        key = (*candidate.key, index)
        if key not in self._raw_by_key:
            try:
                change = self._change(candidate, index).ravel()
            except InputError:
                change = None
            self._raw_by_key[key] = _stored(change)
        return self._raw_by_key[key]

    def _exclusive_channels(self, candidate: Candidate) -> np.ndarray | None:
        other_effects = [setting.effect for setting in self.settings]
        return exclusive_channels(candidate, other_effects, self.problem.model.channels)

    def _compute_exclusive(self, candidate: Candidate) -> None:
        """Store the raw columns of sites with exclusive channels, all by one difference."""
        keys = [(*_single_site(candidate, site).key, 0) for site in candidate.site_indices]
        masks = self._exclusive_channels(candidate)
        if masks is None or all(key in self._raw_by_key for key in keys):
            return
        setting = candidate.setting(np.full(candidate.size, STEP))
        change = self._difference(self.calibration, [*self.settings, setting])
        for key, mask in zip(keys, masks, strict=True):
            self._raw_by_key[key] = _stored((change / STEP * mask).ravel())

    def _change(self, candidate: Candidate, index: int) -> np.ndarray:
        """(N, M): derivative of the readings by one coordinate."""
        if isinstance(candidate.effect, SkinEffect) and candidate.effect.driver != "static":
            laws = self._laws(candidate, index)
            if laws is not None:
                return self._law_change(candidate, *laws)
        if candidate.effect.disc and self.patch_count < 2:  # beside several no touch is solved
            return self._patch_change(candidate)
        step = np.zeros(candidate.size)
        step[index] = STEP
        if self._acts_jointly(candidate):
            step[:] = STEP
        return self._difference(self.calibration, [*self.settings, candidate.setting(step)]) / STEP

    @cached_property
    def patch_count(self) -> int:
        """How many patches the fit's skin has."""
        return len(self.problem.model.geometry(self.calibration, self.settings).patches)

    def _law_change(
        self, candidate: Candidate, impedivity: np.ndarray, conductivity: np.ndarray
    ) -> np.ndarray:
        """(N, M): derivative by a coordinate of an effect of the skin with the laws of `_laws`, by
        the chain rule."""
        total = np.zeros_like(self.voltage)
        for site in np.flatnonzero(np.abs(impedivity).max(axis=0)):
            if candidate.sites is None or site in candidate.sites:
                total += impedivity[:, [site]] * self._by_impedance(int(site), candidate)
        if conductivity.any():
            total += conductivity[:, None] * self._by_conductivity()
        return total

    def _patch_change(self, candidate: Candidate) -> np.ndarray:
        """(N, M): derivative by the contrast of a faint patch, relative as in the untouched skin in
        every frame, which is enough to find its place."""
        model = self.problem.model
        if "skin" not in self._changes:
            geometry = model.geometry(self.calibration, self.settings)
            self._changes["skin"] = forward_model(geometry, "train")
        forward = self._changes["skin"]
        x_mm, y_mm, radius_mm = (candidate.start[key] for key in ("x_mm", "y_mm", "radius_mm"))
        place = x_mm, y_mm, radius_mm
        if not forward.meets([place])[0]:
            return np.zeros_like(self.voltage)
        scale = candidate.scales.typical_change(candidate.effect.parameters["contrast"])
        change = forward.place(*place).channel_change(model.channels, np.array([STEP]))
        untouched = forward.voltages(model.channels)
        return self.voltage * (scale / STEP * change[0] / untouched)

    def _laws(self, candidate: Candidate, index: int) -> tuple[np.ndarray, np.ndarray] | None:
        """(N, n) and (N,): relative derivatives of the contact impedivities and of the conductivity
        by one coordinate, at all sites, in every frame; None where it changes anything else, or a
        site changes another's contact."""
        key = ("laws", candidate.name, tuple(candidate.start.items()), index)
        if key not in self._changes:
            law = self._law(candidate, index)
            self._changes[key] = None if law is None else (law[:, :-1], law[:, -1])
        return self._changes[key]

    def _law(self, candidate: Candidate, index: int) -> np.ndarray | None:
        """(N, n + 1): the laws of `_laws` beside each other."""
        model, effect = self.problem.model, candidate.effect
        assert isinstance(effect, SkinEffect)
        base = Geometry.from_skin(model.skin(self.calibration))
        sites = range(len(base.electrode_deg))
        joint = candidate
        if candidate.sites is not None:
            joint = replace(candidate, sites=tuple(sites), scope="common")
        step = np.zeros(joint.size)
        step[index] = STEP
        setting = joint.setting(step)
        moments = model.moments(self.calibration, self.settings)
        geometries = [apply_skin(base, self.settings, moment) for moment in moments]
        pairs = zip(geometries, moments, strict=True)
        changes = [_scaled(g, effect.change(g, setting, m)) for g, m in pairs]
        if any(change is None for change in changes):
            return None
        law = np.array(changes) / STEP
        if candidate.sites is None:
            return law
        for site in sites:
            row = np.abs(law[:, site]).argmax()
            expected = np.zeros(len(sites) + 1)
            expected[site] = law[row, site]
            single_setting = _single_site(candidate, site).setting(step)
            change = _scaled(
                geometries[row], effect.change(geometries[row], single_setting, moments[row])
            )
            if change is None or not np.allclose(change / STEP, expected):
                return None
        return None if law[:, -1].any() else law

    def _by_impedance(self, site: int, candidate: Candidate) -> np.ndarray:
        """(N, M): derivative by the logarithm of one electrode's contact impedance, with the skin
        and the scales of a candidate."""
        key = ("impedance", site)
        if key not in self._changes:
            effect = next(e for e in EFFECTS.values() if _scaled_attribute(e) == IMPEDIVITY)
            skin, scales = candidate.skin, candidate.scales
            contact = Candidate(effect, "electrodes", (site,), "sparse", {}, skin, scales)
            self._changes[key] = self._change(contact, 0)
        return self._changes[key]

    def _by_conductivity(self) -> np.ndarray:
        """(N, M): derivative by the logarithm of the conductivity."""
        key = ("conductivity",)
        if key not in self._changes:
            model = self.problem.model
            shifted = self.calibration.copy()
            shifted[0] += STEP
            change = self._difference(shifted, self.settings)
            self._changes[key] = change / (STEP * model.calibrations[0].sd)
        return self._changes[key]


def _scaled_attribute(effect: Effect) -> str | None:
    """The attribute of the geometry that an effect multiplies, None of any but such effects."""
    return effect.scaled_attribute if isinstance(effect, SkinEffect) else None


def _scaled(before: Geometry, after: Geometry) -> np.ndarray | None:
    """(n + 1,): relative change of the contact impedivities and of the conductivity; None where
    anything else has changed."""
    if after.key(SCALED_ATTRIBUTES) != before.key(SCALED_ATTRIBUTES):
        return None
    change = np.zeros(len(before.electrode_deg) + 1)
    if not before.points:
        change[:-1] = after.contact_impedivity_ohm_m2 / before.contact_impedivity_ohm_m2 - 1.0
    change[-1] = after.conductivity_S_per_m / before.conductivity_S_per_m - 1.0
    return change


def _stored(column: np.ndarray | None) -> np.ndarray | None:
    """A column in single precision, which is enough for a score test of hundreds; None for none."""
    return column.astype(np.float32) if column is not None and column.any() else None


def _without_directions(directions: list[np.ndarray], columns: np.ndarray) -> np.ndarray:
    """(..., N, M): columns with directions (N, M) projected out, channel by channel."""
    for block in directions:
        columns = columns - (columns * block).sum(axis=-2, keepdims=True) * block
    return columns


def _single_site(candidate: Candidate, site: int) -> Candidate:
    return replace(candidate, sites=(site,), scope="sparse", looks=1)
