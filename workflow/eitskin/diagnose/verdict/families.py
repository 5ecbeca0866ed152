"""Families of a diagnosis: what is a little wrong at every site, its size and its members."""

from typing import Any

import numpy as np

from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.families import family_name
from eitskin.diagnose.fitting.family_sizes import LARGEST_LOG_SD, FamilySizes
from eitskin.diagnose.fitting.held_out import held_out
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.families import Family
from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.search.families import without_family
from eitskin.diagnose.search.gates import FAMILY
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.family_words import family_sentence

CLASS_NATS = 3.0  # fewer, lost without a family whose place others take: one class with these
GROWTH = 1.25  # times its sd, to which a family grows that takes another's place


def families(diagnosis: Diagnosis) -> list[dict]:
    """`families` of diagnosis.json that pass `FAMILY`: of each its sd with a 90 % interval, the
    share of the held-out misfit that returns without it, its members, and the families from which
    it cannot be told.

    The interval is of the size's logarithm, by the curvature of the likelihood of all sizes
    together.
    """
    fitted = diagnosis.named_fit
    if not fitted.problem.model.families:
        return []
    sizes = FamilySizes.from_fit(fitted)
    greatest_sds, best = sizes.greatest()
    log_sds = sizes.log_size_sds(greatest_sds)
    entries = []
    for index, name in enumerate(sizes.names):
        family = COMPONENTS[name]
        assert isinstance(family, Family)
        members = [c for c in fitted.problem.model.families if family_name(c) == name]
        unit, typical = _unit(members[0])
        sd = typical * float(greatest_sds[index])
        factor = float(np.exp(NORMAL_90 * min(log_sds[index], LARGEST_LOG_SD)))
        reduced_sds, likelihood = sizes.greatest([name])
        confused = [
            rival
            for rival, reduced_sd, full_sd in zip(
                sizes.names, reduced_sds, greatest_sds, strict=True
            )
            if best - likelihood < CLASS_NATS and rival != name and reduced_sd > GROWTH * full_sd
        ]
        _, class_likelihood = sizes.greatest([name, *confused])
        if not FAMILY.admits(best - class_likelihood):
            continue
        entry: dict[str, Any] = {
            "name": name,
            "kind": family.group,
            "driver": members[0].effect.driver,
            "sd": {"value": sd, "low": sd / factor, "high": sd * factor, "unit": unit},
            "share": diagnosis.returned_share(
                held_out(without_family(fitted, name), diagnosis.search.folds)
            ),
            "confused_with": confused,
            **_members(diagnosis, members, typical),
        }
        entry["sentence"] = family_sentence(entry)
        entries.append(entry)
    return sorted(entries, key=lambda entry: -entry["share"])


def _unit(candidate: Candidate) -> tuple[str, float]:
    """The unit of a family's sd and a typical change in it; "1" for the logarithm of a value that
    stays above 0."""
    key, _ = candidate.names[0]
    parameter = candidate.effect.parameters[key]
    unit = "1" if parameter.low > 0.0 else parameter.unit
    return unit, candidate.scales.typical_change(parameter)


def _members(diagnosis: Diagnosis, members: list[Candidate], typical: float) -> dict:
    """`sites`, `values` and `values_sd` of a family: of one without sites, the harmonics and the
    amplitudes."""
    fit = diagnosis.named_fit
    model, variances = fit.problem.model, np.diag(fit.covariance)
    sites: list[int] = []
    values: list[float] = []
    sds: list[float] = []
    for candidate, place in model.family_slices:
        if any(candidate is member for member in members):
            sd = typical * model.calibrations[place.start].sd
            deviations, spread = sd * fit.theta[place], sd * np.sqrt(variances[place])
            if candidate.sites is None:
                sites.append(int(candidate.start["harmonic"]))
                values.append(float(np.linalg.norm(deviations)))
                sds.append(float(np.sqrt((spread**2).mean())))
            else:
                sites += [int(site) for site in candidate.sites]
                values += deviations.tolist()
                sds += spread.tolist()
    return {"sites": sites, "values": values, "values_sd": sds}
