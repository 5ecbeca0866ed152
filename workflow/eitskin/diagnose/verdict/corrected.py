"""The corrected simulator in the configuration's own form: effects.yaml."""

import re
from typing import Any

import numpy as np
import pandas as pd
import yaml

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.estimates import length_scale
from eitskin.diagnose.fitting.fit import Fit
from eitskin.effects.settings import site_counts
from eitskin.errors import InputError, printable
from eitskin.physics.outline import as_stated
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from eitskin.simulate.sets import sample_settings

ONE_AMPERE = 1.0  # so that simulated volts are the ohms that were recorded
LAID_OUT = ("radius_mm", "electrode_deg")  # null beside an outline
LAYOUT = {"session_frames": 300, "crossed": False}  # as the configuration `authors`


def effect_items(fit: Fit) -> list[dict]:
    """The families and the effects of a fit as the configuration writes them."""
    model, items = fit.problem.model, []
    calibration = fit.theta[: len(model.calibrations)]
    coordinates = [fit.theta[fit.coordinate_slice(index)] for index in range(len(fit.effects))]
    pairs = zip(fit.effects, coordinates, strict=True)
    for candidate, values in [*model.family_coordinates(calibration), *pairs]:
        item = candidate.item(values)
        parameters = item.setdefault("parameters", {})
        for key, parameter in candidate.effect.parameters.items():
            if parameter.whole and key in parameters:
                parameters[key] = int(parameters[key])
        for key, value in candidate.effect.recorded_values(model.force_max_N).items():
            parameters.setdefault(key, value)
        items.append(item)
    return items


def configuration(fit: Fit, recording: Recording, noise_sd: np.ndarray, name: str) -> dict:
    """What a configuration needs to simulate a recording: the skin as calibrated, the protocol, and
    the effects as a twin and as the set `corrected-NAME`.

    noise_sd (M,): of the readings, in the recording's unit. The set is without effects that single
    samples, which have no time, cannot show.
    """
    model = fit.problem.model
    calibration = fit.theta[: len(model.calibrations)]
    skin = {
        key: value
        for key, value in as_stated(model.skin(calibration)).metadata().items()
        if value is not None or key in LAID_OUT
    }
    if model.unit == "ohm":
        skin["current_A"] = ONE_AMPERE
    effects = effect_items(fit)
    factor = model.calibration_values(calibration).get("factor", 1.0)
    states = pd.DataFrame({"time_s": [0.0], "touch": [False], "force_N": [0.0]})
    states = states.assign(x_mm=np.nan, y_mm=np.nan, probe_mm=np.nan)
    untouched = simulate(
        states,
        np.array([-1]),
        Skin.from_metadata(skin),
        model.channels,
        [*fit.family_settings(), *fit.settings()],
        model.accuracy(calibration, fit.settings()),
        frame_s=model.frame_s,
        sink_grounded=model.sink_grounded,
        force_max_N=model.force_max_N,
    )
    share = float(np.median(noise_sd) / (factor * np.median(np.abs(untouched))))
    protocol = _protocol(recording)
    return {
        "skin": skin,
        "protocol": protocol,
        "configurations": {
            f"corrected-{_configuration_name(name)}": {
                "effects": [item for item in effects if _is_timeless(item, model.channels)],
                "noise": share,
                "baseline": "averaged" if model.difference else "paired",
                **LAYOUT,
            }
        },
        "twin": {"skin": skin, "protocol": protocol, "effects": effects, "noise": share},
    }


def yaml_text(fit: Fit, recording: Recording, noise_sd: np.ndarray, name: str) -> str:
    """The configuration as YAML, with what a configuration cannot say in a comment."""
    content = configuration(fit, recording, noise_sd, name)
    model = fit.problem.model
    (sets,) = content["configurations"].values()
    comments = [f"The corrected simulator of {name}: give it with --configfile."]
    timed = [i["name"] for i in content["twin"]["effects"] if i not in sets["effects"]]
    if timed:
        comments.append(f"In the twin alone, since samples have no time: {', '.join(timed)}.")
    if model.unit == "ohm":
        comments.append("Readings are volts at 1 A, which are the ohms that were recorded.")
    elif model.unit == "arbitrary":
        factor = model.calibration_values(fit.theta[: len(model.calibrations)])["factor"]
        comments.append(f"Readings are volts; {factor!r} times as much is the recording's unit.")
    if length_scale(fit):
        comments.append("No length of the skin is known: those in mm are shares of radius_mm.")
    if model.sink_grounded:
        comments.append("The source is simulated as floating; the recording's sink is grounded.")
    lines = "".join(f"# {printable(line)}\n" for line in comments)
    style: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "width": 100}
    return lines + yaml.dump(content, Dumper=_WithoutReferences, **style)


class _WithoutReferences(yaml.SafeDumper):
    """Writes what stands in two places twice, rather than a reference."""

    def ignore_aliases(self, data: object) -> bool:
        """Never refer."""
        return True


def _is_timeless(item: dict, channels: np.ndarray) -> bool:
    """Whether samples without a time can show an effect."""
    try:
        sample_settings([item], site_counts(channels), (0, 0))
    except InputError:
        return False
    return True


def _protocol(recording: Recording) -> dict:
    """Patterns that make the recording's channels; where there are none, the channels."""
    channels, n = recording.channels, recording.n_electrodes
    patterns = ["adjacent", "opposite", *(f"skip-{k}" for k in range(1, n - 1))]
    for drive in patterns:
        for measure in patterns:
            try:
                table = channel_table(n, drive, measure)
            except InputError:
                continue
            if np.array_equal(table, channels):
                return {"drive": drive, "measure": measure}
    return {"drive": "adjacent", "measure": "adjacent", "channels": channels.tolist()}


def _configuration_name(name: str) -> str:
    """A name as the configuration has them, of a-z, 0-9 and -."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "recording"
