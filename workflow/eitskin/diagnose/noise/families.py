"""What is a little wrong at every site of an ordinary skin or board: one class each.

A family's members are the values of one effect at all sites: independent, of mean 0 and of one sd,
which is learned like that of the errors of a rig (`component_sds`). Kaipio and Somersalo
(Statistical and Computational Inverse Problems, 2005, section 5.8) call this the approximation
error of a model; here its covariance is built of named physics. Sds are in typical changes of the
catalogue (`Parameter.scale`), which is the sd of their half-normal priors too. The columns come
with the `Linearisation`.
"""

from typing import ClassVar

import numpy as np

from eitskin.diagnose.noise.components import NoiseComponent, component
from eitskin.diagnose.noise.linearisation import Linearisation

TYPICAL_CHANGES = "typical changes"


class Family(NoiseComponent):
    """A family of one effect at every site of a kind, or at several starts.

    name: in diagnosis.json; effect: of the catalogue; sites: the kind of its sites, None for an
    effect without; starts: values of parameters without a neutral value, one member each; group:
    the kind of family in diagnosis.json.
    """

    unit, prior_sd, acts_on = TYPICAL_CHANGES, 1.0, "whole"
    discrepancy = True
    largest = 30.0
    effect: ClassVar[str]
    sites: ClassVar[str | None]
    starts: ClassVar[tuple[dict[str, float], ...]] = ({},)
    group: ClassVar[str]

    def is_present(self, linearisation: Linearisation) -> bool:
        """Whether a fit has the family's columns."""
        return self.name in linearisation.families

    def basis(self, linearisation: Linearisation) -> np.ndarray:
        """(K, N, M): what a typical change of each of K members does to the readings."""
        return linearisation.families[self.name]


@component
class DriveGains(Family):
    """The source's current differs from drive to drive."""

    name = effect = "drive-gain"
    sites, group = "drives", "gain"


@component
class MeasurementGains(Family):
    """The amplifier's gain differs from measuring pair to measuring pair."""

    name = effect = "measurement-gain"
    sites, group = "measures", "gain"


@component
class Offsets(Family):
    """Each measuring pair has an offset."""

    name = effect = "offset"
    sites, group = "measures", "instrument"


@component
class ElectrodePositions(Family):
    """Each electrode is a little off its place."""

    name = effect = "electrode-position"
    sites, group = "electrodes", "electrode"


@component
class ElectrodeWidths(Family):
    """Each electrode is a little wider or narrower than stated."""

    name = effect = "electrode-width"
    sites, group = "electrodes", "electrode"


@component
class ContactImpedances(Family):
    """Each electrode's contact is a little better or worse."""

    name = effect = "contact-impedance"
    sites, group = "electrodes", "electrode"


@component
class GroundLeaks(Family):
    """A little current leaks to ground from each electrode."""

    name = effect = "ground-leak"
    sites, group = "electrodes", "electrode"


@component
class RimModes(Family):
    """The rim is a little out of round."""

    name, effect = "rim-modes", "domain-shape"
    sites, group = None, "body"
    starts = tuple({"harmonic": float(harmonic)} for harmonic in range(2, 6))
