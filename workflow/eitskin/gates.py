"""Whether a frame shows a touch at all, and whether it looks like what a model was trained on."""

import torch
from torch import Tensor

from eitskin.dataset import upper_limit

COMPONENTS = 16
REFERENCES = 2000
FALSE_ALARMS = 0.01  # of validation frames abstained from, and of untouched frames called touched


def activity(delta_V: Tensor, scale: Tensor) -> Tensor:
    """Size of a change (N, M): its root mean square over the channels, each by its scale (M,)."""
    return (delta_V.double() / scale).square().nanmean(dim=1).sqrt()


def touch_gate(delta_V: Tensor, spread: Tensor, untouched: dict | None) -> dict:
    """The activity above which a frame is called touched, and the channels' `scale` (M,).

    From the untouched frames' noise where the dataset has it (`dataset.untouched_noise`): 1 % of
    untouched frames lie above. Otherwise from the touches alone, changes (N, M) of the validation
    part by their `spread` (M,): 1 % of touches lie below; nothing is then known of false touches.
    `detected`: share of the validation touches above it.
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


def scores(voltage: Tensor, components: Tensor, variances: Tensor) -> tuple[Tensor, Tensor]:
    """Whitened scores (N, K) in a principal subspace, and the squared residual (N,) off it.

    Of standardised voltages (N, M); components (M, K), variances (K,) of the training frames.
    """
    score = voltage.double() @ components
    residual = (voltage.double() - score @ components.T).square().sum(dim=1)
    return score / variances.sqrt(), residual


def nearest(score: Tensor, references: Tensor) -> Tensor:
    """Distance (N,) from each score (N, K) to the nearest reference (R, K)."""
    exact = "donot_use_mm_for_euclid_dist"
    blocks = [torch.cdist(s, references, compute_mode=exact) for s in score.split(1024)]
    return torch.cat([block.min(dim=1).values for block in blocks])


def familiar_gate(train: Tensor, validation: Tensor) -> dict:
    """What training looked like: a principal subspace of its standardised voltages (N, M), the
    scores of frames spread over it as references, and the limits of the residual off the subspace
    and of the distance to the nearest reference within it.

    The residual sees what no touch does (a channel off, another order, noise); the distance what
    no touch did (the sign, a gain, a stronger touch), which a linear subspace cannot tell. A frame
    like the validation part's exceeds each limit with a probability of 0.5 % at most, and is
    abstained from with 1 % at most; below 200 such frames, a limit is their largest value.
    """
    train = train.double().cpu()
    variance, vector = torch.linalg.eigh(train.T @ train / len(train))
    count = min(COMPONENTS, train.shape[1] - 1, int((variance > 1e-9 * variance[-1]).sum()))
    components, variances = vector[:, -count:].contiguous(), variance[-count:].contiguous()
    rows = torch.linspace(0, len(train) - 1, min(REFERENCES, len(train))).round().long()
    references, _ = scores(train[rows], components, variances)
    score, residual = scores(validation.cpu(), components, variances)
    share = 1 - FALSE_ALARMS / 2
    return {
        "components": components,
        "variances": variances,
        "references": references,
        "limit_residual": upper_limit(residual.numpy(), share),
        "limit_distance": upper_limit(nearest(score, references).numpy(), share),
    }
