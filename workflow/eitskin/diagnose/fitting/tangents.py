"""What every candidate would change, to first order, about a fit.

Sites are differentiated once; the same columns serve a site alone, all sites with one value and
each with its own. An effect of the skin that scales contact impedances or the conductivity as the
moment has it is, to first order, their columns times its law, frame by frame. Any other is a
difference of the simulator.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from eitskin import cores
from eitskin.diagnose.fitting.candidates import Candidate, own_channels
from eitskin.diagnose.fitting.fit import STEP, Fit
from eitskin.diagnose.noise.low_rank import BATCH_COLUMNS
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.effects.contact_impedance import ContactImpedance
from eitskin.effects.effect import Setting, SkinEffect
from eitskin.errors import InputError
from eitskin.physics.depth import span
from eitskin.physics.geometry import Geometry
from eitskin.physics.solver import forward_model
from eitskin.simulate.readings import apply_skin

NEAR = 0.03  # of the readings, by which two fits may differ and share their derivatives
SPREAD = 0.1  # of an electrode's width, over which a contact spreads the current: few modes do then
LEAST = 1e-12  # of a column's squared length: with less left it is a fitted one
SCALED = ("contact_impedivity_ohm_m2", "conductivity_S_per_m")


class Tangents:
    """Whitened columns (N M,) of candidates about `fit`, the fitted ones projected out.

    `of(candidate)` gives (k, N M), k at most its size: coordinates that change nothing to first
    order have none. `like`: tangents about other fits, whose derivatives serve where their readings
    are near enough; any direction makes a valid test, and a fit finds its own way. Whitened columns
    are kept until `forget`: a site's alone, among all and with one value for all are the same.
    """

    def __init__(self, fit: Fit, like: "Iterable[Tangents]" = ()):
        self.fit = fit
        self.problem = fit.problem
        self.knobs, self.chosen = self.problem.split(fit.theta, fit.effects)
        self.voltage = self.problem.model.voltage(self.knobs, self.chosen)
        self.accuracy = self._accuracy()
        self.base = self.voltage
        if self.accuracy != "diagnose":
            self.base = self.problem.model.voltage(self.knobs, self.chosen, self.accuracy)
        self.blocks, rest = self._blocks()
        directions, triangle = np.linalg.qr(rest.T)
        turn, size, _ = np.linalg.svd(triangle)
        self.fitted = turn.T[size > 1e-9 * size.max(initial=0.0)] @ directions.T
        self.residual = self.away(fit.residual.ravel())
        self.source = self
        for other in like:
            if self._near(other.source):
                self.source = other.source
                break
        self._columns: dict[tuple, np.ndarray | None] = {}
        self._apart: dict[tuple, np.ndarray | None] = {}
        self._changes: dict[Any, Any] = {}

    def _accuracy(self) -> str:
        """Of what is differenced: train, in a tenth of the time, for a body, whose derivatives are
        the same to 6e-3, and in two thirds for a sheet of which they are to 1e-3
        (`tests/unit/diagnose/fitting/test_tangents.py`)."""
        there = self.problem.model.geometry(self.knobs, self.chosen)
        if span(there) is not None or there.points:
            return "train"
        spread = (there.contact_length_mm / there.electrode_width_mm).min()
        return "train" if spread >= SPREAD else "diagnose"

    def _difference(self, knobs: np.ndarray, moved: list[Setting]) -> np.ndarray:
        """(N, M): what readings change from this state to one close by."""
        return self.problem.model.voltage(knobs, moved, self.accuracy) - self.base

    def _near(self, other: "Tangents") -> bool:
        apart = np.linalg.norm(self.voltage - other.voltage)
        return bool(apart < NEAR * np.linalg.norm(other.voltage))

    def _blocks(self) -> tuple[list[np.ndarray], np.ndarray]:
        """What is fitted to every channel on its own, (N, M) each, orthonormal channel by channel;
        and the other coordinates' columns (k, N M) less that."""
        blocks: list[np.ndarray] = []
        for block in self.fit.slopes.blocks:
            column = _off(blocks, block.column)
            length = np.linalg.norm(column, axis=0)
            blocks.append(column / np.where(length > 0, length, 1.0))
        rest = self.fit.slopes.columns
        return blocks, _off(blocks, rest).reshape(len(rest), self.voltage.size)

    def away(self, columns: np.ndarray) -> np.ndarray:
        """(..., N M): columns less what the fitted coordinates can do."""
        if self.blocks:
            apart = _off(self.blocks, columns.reshape(*columns.shape[:-1], *self.voltage.shape))
            columns = apart.reshape(columns.shape)
        return columns - (columns @ self.fitted.T) @ self.fitted

    def of(self, candidate: Candidate) -> np.ndarray:
        """(k, N M) of a candidate, by its sites."""
        kept = [column for column in self.each(candidate) if column is not None]
        return np.array(kept, float).reshape(len(kept), self.residual.size)

    def each(self, candidate: Candidate) -> list[np.ndarray | None]:
        """(N M,) of every linear coordinate, of a site each where there are several, in single
        precision; None of those that change nothing."""
        return self._each(candidate, self._apart_of)

    def count(self, candidate: Candidate) -> int:
        """How many columns `each` has of a candidate."""
        if candidate.sites is None or self._together(candidate):
            return int(candidate.linear.sum())
        return 1 if candidate.scope == "common" else len(candidate.sites)

    def along(self, candidate: Candidate, weights: np.ndarray) -> np.ndarray:
        """(count,): products of weights (N M,) with what each coordinate changes in the readings,
        neither whitened nor projected."""
        raw = self._each(candidate, self.source._raw_of)
        return np.array([0.0 if column is None else column @ weights for column in raw])

    def whiten(self, candidates: Iterable[Candidate]) -> None:
        """Finds the whitened columns of many candidates, faster than one by one."""
        singles = [single for one in candidates for single in self._singles(one)]
        self.source._find(singles)
        self._apart_of(singles)

    def _find(self, singles: list[tuple[Candidate, int]]) -> None:
        """Columns as of `_raw`, shared out among processes. An effect's columns stay together, and
        so do those of all effects that vary from frame to frame, which share derivatives."""
        groups: dict[str, list[tuple[Candidate, int]]] = {}
        for candidate, index in singles:
            if (*candidate.key, index) not in self._columns:
                effect = candidate.effect
                varies = isinstance(effect, SkinEffect) and effect.driver != "static"
                name = "varies" if varies else candidate.name
                groups.setdefault(name, []).append((candidate, index))
        shares = cores.shares(groups.values())
        found = self.problem.model.near.forked(self._raw_of, shares)
        for share, own in zip(shares, found, strict=True):
            for (candidate, index), column in zip(share, own, strict=True):
                self._columns[(*candidate.key, index)] = column

    @cached_property
    def in_single(self) -> Whitening:
        """The fit's whitening in single precision, kept until `forget`."""
        return self.problem.whitening.single_precision

    def forget(self) -> None:
        """Let go of whitened columns, which are found anew where they are asked for."""
        self._apart.clear()
        vars(self).pop("in_single", None)

    def _each(self, candidate: Candidate, columns: Callable) -> list[np.ndarray | None]:
        singles = columns(self._singles(candidate))
        if candidate.scope != "common":
            return singles
        per_key = len(singles) // len(candidate.own_sites)
        total: Any = sum(s for s in singles[::per_key] if s is not None)
        return [total if np.any(total) else None]

    def jacobian(self, candidate: Candidate) -> np.ndarray:
        """(size, N, M): whitened derivatives by every coordinate, NaN for those without, and for
        those that are as soon found anew."""
        shape = candidate.size, *self.voltage.shape
        if candidate.kind == "channels" and self._own_channels(candidate) is not None:
            return np.broadcast_to(np.nan, shape)
        found = np.full(shape, np.nan)
        columns = self.of(candidate)
        linear = np.flatnonzero(candidate.linear)
        if len(columns) == len(linear):
            found[linear] = columns.reshape(-1, *self.voltage.shape)
        return found

    def tried(self, candidate: Candidate) -> np.ndarray | None:
        """(N M,): what a candidate at its start would change, the fitted projected out; None where
        the physics has no such state."""
        setting = candidate.setting(np.zeros(candidate.size))
        try:
            moved = self.problem.model.voltage(self.knobs, [*self.chosen, setting])
        except InputError:
            return None
        return self.away(self.problem.whitening(moved - self.voltage).ravel())

    def _singles(self, candidate: Candidate) -> list[tuple[Candidate, int]]:
        """One candidate and coordinate a column; of a candidate with sites, one a site."""
        if candidate.sites is None or self._together(candidate):
            return [(candidate, int(i)) for i in np.flatnonzero(candidate.linear)]
        if len(candidate.sites) > 1:
            self.source._split(candidate)
        return [(_alone(candidate, site), 0) for site in candidate.sites]

    @staticmethod
    def _together(candidate: Candidate) -> bool:
        """Whether the sites act only together."""
        return candidate.effect.stage == "wiring" and candidate.scope == "sparse"

    def _apart_of(self, singles: list[tuple[Candidate, int]]) -> list[np.ndarray | None]:
        """Whitened columns, the fitted projected out, kept; None of those that change nothing."""
        raw = {(*c.key, i): self.source._raw(c, i) for c, i in singles}
        new = {k: own for k, own in raw.items() if own is not None and k not in self._apart}
        if new:
            self._apart.update(zip(new, self._whitened([*new.values()]), strict=True))
        return [self._apart.get(key) for key in raw]

    def _whitened(self, raw: list[np.ndarray]) -> list[np.ndarray | None]:
        """Columns whitened, the fitted projected out; None of those that are fitted ones."""
        whitening = self.in_single

        def apart(group: list[np.ndarray]) -> list[np.ndarray | None]:
            white = whitening(np.array(group).reshape(-1, *self.voltage.shape))
            white = white.reshape(len(group), -1).astype(float)
            lengths = [float(column @ column) for column in white]
            left = zip(self.away(white), lengths, strict=True)
            return [_kept(own if own @ own > LEAST * length else None) for own, length in left]

        groups = [raw[start : start + BATCH_COLUMNS] for start in range(0, len(raw), BATCH_COLUMNS)]
        return [column for group in cores.threaded(apart, groups) for column in group]

    def _raw_of(self, singles: list[tuple[Candidate, int]]) -> list[np.ndarray | None]:
        return [self._raw(candidate, index) for candidate, index in singles]

    def _raw(self, candidate: Candidate, index: int) -> np.ndarray | None:
        """(N M,) in the recording's unit, kept in single precision; None where nothing changes."""
        key = (*candidate.key, index)
        if key not in self._columns:
            try:
                change = self._change(candidate, index).ravel()
            except InputError:
                change = None
            self._columns[key] = _kept(change)
        return self._columns[key]

    def _own_channels(self, candidate: Candidate) -> np.ndarray | None:
        others = [setting.effect for setting in self.chosen]
        return own_channels(candidate, others, self.problem.model.channels)

    def _split(self, candidate: Candidate) -> None:
        """The columns of sites with channels of their own, all by one step."""
        keys = [(*_alone(candidate, site).key, 0) for site in candidate.own_sites]
        own = self._own_channels(candidate)
        if own is None or all(key in self._columns for key in keys):
            return
        moved = candidate.setting(np.full(candidate.size, STEP))
        change = self._difference(self.knobs, [*self.chosen, moved])
        for key, mask in zip(keys, own, strict=True):
            self._columns[key] = _kept((change / STEP * mask).ravel())

    def _change(self, candidate: Candidate, index: int) -> np.ndarray:
        """(N, M): derivative of the readings by one coordinate."""
        if isinstance(candidate.effect, SkinEffect) and candidate.effect.driver != "static":
            laws = self._laws(candidate, index)
            if laws is not None:
                return self._driven(candidate, *laws)
        if candidate.effect.disc:
            return self._patched(candidate)
        step = np.zeros(candidate.size)
        step[index] = STEP
        if self._together(candidate):
            step[:] = STEP
        return self._difference(self.knobs, [*self.chosen, candidate.setting(step)]) / STEP

    def _driven(
        self, candidate: Candidate, impedivity: np.ndarray, conductivity: np.ndarray
    ) -> np.ndarray:
        """An effect of the skin that varies from frame to frame, of the laws that `_laws` finds, by
        the chain rule."""
        total = np.zeros_like(self.voltage)
        for site in np.flatnonzero(np.abs(impedivity).max(axis=0)):
            if candidate.sites is None or site in candidate.sites:
                total += impedivity[:, [site]] * self._by_impedance(int(site), candidate)
        if conductivity.any():
            total += conductivity[:, None] * self._by_conductivity()
        return total

    def _patched(self, candidate: Candidate) -> np.ndarray:
        """A faint patch as the untouched skin has it, in every frame: enough to find its place."""
        model = self.problem.model
        if "skin" not in self._changes:
            there = model.geometry(self.knobs, self.chosen)
            self._changes["skin"] = forward_model(there, "train")
        forward = self._changes["skin"]
        x_mm, y_mm, radius_mm = (candidate.start[key] for key in ("x_mm", "y_mm", "radius_mm"))
        place = x_mm, y_mm, radius_mm
        if not forward.meets([place])[0]:
            return np.zeros_like(self.voltage)
        scale = candidate.scales.of(candidate.effect.parameters["contrast"])
        change = forward.place(*place).channel_change(model.channels, np.array([STEP]))
        untouched = forward.voltages(model.channels)
        return self.voltage * (scale / STEP * change[0] / untouched)

    def _laws(self, candidate: Candidate, index: int) -> tuple[np.ndarray, np.ndarray] | None:
        """(N, n) and (N,): relative change of contact impedivities and conductivity by one
        coordinate, all sites together, frame by frame; None where it changes anything else, or a
        site more than its own contact."""
        key = ("laws", candidate.name, tuple(candidate.start.items()), index)
        if key not in self._changes:
            law = self._law(candidate, index)
            self._changes[key] = None if law is None else (law[:, :-1], law[:, -1])
        return self._changes[key]

    def _law(self, candidate: Candidate, index: int) -> np.ndarray | None:
        """(N, n + 1) of `_laws`, the conductivity's last."""
        model, effect = self.problem.model, candidate.effect
        assert isinstance(effect, SkinEffect)
        base = Geometry.from_skin(model.skin(self.knobs))
        sites = range(len(base.electrode_deg))
        whole = candidate
        if candidate.sites is not None:
            whole = replace(candidate, sites=tuple(sites), scope="common")
        step = np.zeros(whole.size)
        step[index] = STEP
        setting = whole.setting(step)
        moments = model.moments(self.knobs, self.chosen)
        there = [apply_skin(base, self.chosen, moment) for moment in moments]
        pairs = zip(there, moments, strict=True)
        found = [_scaled(g, effect.change(g, setting, m)) for g, m in pairs]
        if any(change is None for change in found):
            return None
        law = np.array(found) / STEP
        if candidate.sites is None:
            return law
        for site in sites:
            row = np.abs(law[:, site]).argmax()
            own = np.zeros(len(sites) + 1)
            own[site] = law[row, site]
            alone = _alone(candidate, site).setting(step)
            change = _scaled(there[row], effect.change(there[row], alone, moments[row]))
            if change is None or not np.allclose(change / STEP, own):
                return None
        return None if law[:, -1].any() else law

    def _by_impedance(self, site: int, like: Candidate) -> np.ndarray:
        """(N, M): derivative by the logarithm of one electrode's contact impedance."""
        key = ("impedance", site)
        if key not in self._changes:
            contact = Candidate(
                ContactImpedance(),
                "electrodes",
                (site,),
                "sparse",
                {},
                like.skin,
                like.scales,
            )
            self._changes[key] = self._change(contact, 0)
        return self._changes[key]

    def _by_conductivity(self) -> np.ndarray:
        """(N, M): derivative by the logarithm of the conductivity."""
        key = ("conductivity",)
        if key not in self._changes:
            model = self.problem.model
            moved = self.knobs.copy()
            moved[0] += STEP
            changed = self._difference(moved, self.chosen)
            self._changes[key] = changed / (STEP * model.calibrations[0].sd)
        return self._changes[key]


def _scaled(before: Geometry, after: Geometry) -> np.ndarray | None:
    """(n + 1,): relative change of the contact impedivities and of the conductivity; None where
    anything else has changed."""
    if after.key(SCALED) != before.key(SCALED):
        return None
    change = np.zeros(len(before.electrode_deg) + 1)
    if not before.points:
        change[:-1] = after.contact_impedivity_ohm_m2 / before.contact_impedivity_ohm_m2 - 1.0
    change[-1] = after.conductivity_S_per_m / before.conductivity_S_per_m - 1.0
    return change


def _kept(column: np.ndarray | None) -> np.ndarray | None:
    """A column in single precision: there are hundreds, and a test needs no more."""
    return column.astype(np.float32) if column is not None and column.any() else None


def _off(blocks: list[np.ndarray], columns: np.ndarray) -> np.ndarray:
    """(..., N, M): columns less their parts along the blocks (N, M), channel by channel."""
    for block in blocks:
        columns = columns - (columns * block).sum(axis=-2, keepdims=True) * block
    return columns


def _alone(candidate: Candidate, site: int) -> Candidate:
    return replace(candidate, sites=(site,), scope="sparse", looks=1)
