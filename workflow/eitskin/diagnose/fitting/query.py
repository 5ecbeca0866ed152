"""Readings predicted by a fit for states and channels of a query."""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from eitskin.data.check import naming
from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.channel_mapping import mapped_setting, unmapped_channels
from eitskin.diagnose.fitting.fit import Fit, Problem, difference
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.errors import InputError

# Shares of a query's largest force up to which predictions are tried, the largest first.
FORCE_SHARES = np.linspace(1.0, 0.0, 11)
SITE_NOUNS = {"drives": "drive", "measures": "measuring pair", "channels": "channel"}


def predict(fit: Fit, recording: Recording, query: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Voltages (N, M) of a query's states by its channels, noise-free, and their standard
    deviations, by a fit of a recording. Raises InputError for touches of unknown state.

    Where the laws of the fit have no physics at a force, as they may beyond the forces of the
    recording, touches are predicted as at the largest force at which they have: a line on stderr
    says so. So does one of channels at whose drive or pair the recording cannot show an effect:
    they are predicted without it, as uncertain as its sites differ.
    """
    force = query.frames["force_N"].to_numpy(float)
    unmapped = _unmapped_effects(fit, recording, query)
    refusal: InputError | None = None
    for limit in np.nanmax(force, initial=0.0) * FORCE_SHARES:
        lighter = query.frames.assign(force_N=np.minimum(force, limit))
        voltage = simulator(fit, recording, replace(query, frames=lighter))
        try:
            mean = voltage(fit.theta)
            derivatives = [difference(voltage, fit.theta, mean, i) for i in range(len(fit.theta))]
            spreads = [voltage(fit.theta, index) - mean for index in unmapped]
        except InputError as error:
            refusal = refusal or error
            continue
        if refusal:
            line = f"touches above {limit:.3g} N are predicted as at {limit:.3g} N: {refusal}"
            print(f"  {line}", file=sys.stderr, flush=True)
        slopes = np.array(derivatives).reshape(len(fit.theta), *mean.shape)
        errors = np.einsum("pq,pnm->qnm", fit.root, slopes)
        variance = (errors**2).sum(axis=0) + sum(spread**2 for spread in spreads)
        return mean, np.sqrt(variance)
    assert refusal is not None
    raise refusal


def _unmapped_effects(fit: Fit, recording: Recording, query: Recording) -> list[int]:
    """The indices of the families and effects of a recording's fit that some of a query's channels
    are predicted without; a line on stderr each says of which."""
    indices = []
    for index, setting in enumerate([*fit.family_settings(), *fit.settings()]):
        rows = unmapped_channels(setting, recording.channels, query.channels)
        if len(rows):
            indices.append(index)
            assert setting.kind is not None
            channels = naming.channels(query, rows)
            line = f"{setting.effect.name}: {channels} of the query are predicted without it, for"
            line += f" the recording has no such {SITE_NOUNS[setting.kind]}; std_V has its spread"
            print(f"  {line}", file=sys.stderr, flush=True)
    return indices


def simulator(fit: Fit, recording: Recording, query: Recording) -> Callable[..., np.ndarray]:
    """Voltages (N, M) of a query's states by its channels, noise-free, as a function of the
    coordinates (P,) of a recording's fit, and of the index of a family or an effect that differs by
    its spread at sites which the recording does not have. Raises InputError for touches of unknown
    state."""
    problem = Problem(
        RecordingSimulator(query, fit.problem.model), np.zeros(1), fit.problem.whitening
    )
    if not problem.model.simulable.all():
        row = int(np.flatnonzero(~problem.model.simulable)[0])
        raise InputError("query", f"row {row}", "a touch of unknown state", "x, y, force and probe")

    def voltage(theta: np.ndarray, unmapped: int | None = None) -> np.ndarray:
        calibration, settings = problem.split(theta, fit.effects)
        settings = [*fit.problem.model.family_settings(calibration), *settings]
        mapped = [
            mapped_setting(setting, recording.channels, query.channels, float(index == unmapped))
            for index, setting in enumerate(settings)
        ]
        return problem.model.voltage(calibration, mapped)

    return voltage
