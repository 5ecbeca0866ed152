"""Gates of a frame: whether it shows a touch, and whether it is like those of the training set."""

import torch
from torch import Tensor

from eitskin.data.baseline import upper_limit

COMPONENTS = 16  # of the touches' subspace: ample for a state of three or four targets
REFERENCES = 2000  # training frames to which distances are taken, spread evenly
RIDGE = 0.1  # of the mean variance outside the subspace, added to every variance
FALSE_ALARMS = 0.01  # of validation frames abstained from, and of untouched frames called touched


def activity(delta_V: Tensor, scale: Tensor) -> Tensor:
    """Size of a change (N, M): its root mean square over the channels, each by its scale (M,)."""
    return (delta_V.double() / scale).square().nanmean(dim=1).sqrt()


def touch_gate(delta_V: Tensor, spread: Tensor, untouched: dict | None) -> dict:
    """The activity above which a frame is called touched, and the channels' `scale` (M,).

    Where the dataset has the noise of untouched frames (`baseline.untouched_noise`), 1 % of these
    lie above. Otherwise 1 % of the validation part's touches lie below, with changes (N, M) in
    units of their `spread` (M,); the rate of false touches is then unknown. `detected`: share of
    the validation touches above the threshold.
    """
    if untouched:
        scale = torch.tensor(untouched["rms"], dtype=torch.float64)
        threshold = untouched["quantile_99"]
        calibrated_on = "untouched frames"
    else:
        scale = spread.double()
        threshold = -upper_limit(-activity(delta_V, scale).numpy(), 1 - FALSE_ALARMS)
        calibrated_on = "weakest touches"
    detected = float((activity(delta_V, scale) > threshold).double().mean())
    return {
        "scale": scale,
        "threshold": threshold,
        "calibrated_on": calibrated_on,
        "detected": detected,
    }


def whiten(voltage: Tensor, axes: Tensor, variances: Tensor) -> tuple[Tensor, Tensor]:
    """Standardised voltages (N, M) along the principal `axes` (M, M) over the root of `variances`
    (M,), rising: all but the last K (N, M - K), and the last K (N, K), the touches' subspace."""
    whitened = (voltage.double() @ axes) / variances.sqrt()
    outer, score = whitened.tensor_split([-min(COMPONENTS, len(axes) - 1)], dim=1)
    return outer, score


def strangeness(
    voltage: Tensor, axes: Tensor, variances: Tensor, references: Tensor
) -> tuple[Tensor, Tensor]:
    """Residual and distance (N,) of standardised voltages (N, M).

    Residual: root mean square outside the touches' subspace. Distance: within it, to the nearest of
    the `references` (R, K), over √K. Both relative to √(1 + mean square within the subspace), as
    the unexplained part grows with the strength of a touch.
    """
    outer, score = whiten(voltage, axes, variances)
    strength = (1 + score.square().mean(dim=1)).sqrt()
    exact = "donot_use_mm_for_euclid_dist"
    blocks = [torch.cdist(s, references, compute_mode=exact) for s in score.split(1024)]
    nearest = torch.cat([block.min(dim=1).values for block in blocks]) / score.shape[1] ** 0.5
    return outer.square().mean(dim=1).sqrt() / strength, nearest / strength


def familiar_gate(train: Tensor, validation: Tensor) -> dict:
    """The distribution of the training part: the principal axes of its standardised voltages
    (N, M), their variances, references, and the limits of residual and distance.

    The residual responds to changes outside the touches' subspace (a dead channel, another order,
    noise), the distance to those within it (the sign, a gain, a stronger touch). A frame like the
    validation part's exceeds each limit with a probability of at most 0.5 %, so that at most 1 %
    are abstained from; with fewer than 200 validation frames a limit is their largest value.
    """
    train = train.double().cpu()
    variances, axes = torch.linalg.eigh(train.T @ train / len(train))
    outer_variances = variances[: -min(COMPONENTS, len(axes) - 1)]
    # few frames, or frames without noise, leave directions without variance
    variances = variances.clamp(min=0) + RIDGE * outer_variances.mean().clamp(min=1e-6)
    rows = torch.linspace(0, len(train) - 1, min(REFERENCES, len(train))).round().long()
    tensors = {
        "axes": axes.contiguous(),
        "variances": variances,
        "references": whiten(train[rows], axes, variances)[1].contiguous(),
    }
    residual, distance = strangeness(validation.cpu(), **tensors)
    return {
        **tensors,
        "limit_residual": upper_limit(residual.numpy(), 1 - FALSE_ALARMS / 2),
        "limit_distance": upper_limit(distance.numpy(), 1 - FALSE_ALARMS / 2),
    }
