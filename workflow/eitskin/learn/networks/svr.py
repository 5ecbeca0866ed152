"""Support vectors."""

import numpy as np
import torch
from torch import Tensor, nn

from eitskin.learn.networks import Shape


class Svr(nn.Module):
    """Fitted support vector regression with a Gaussian kernel, its vectors shared by the targets:
    states (B, T) float64 = Σ_s dual[t, s] exp(-gamma ‖v - support[s]‖²) + intercept[t]."""

    support: Tensor
    dual: Tensor
    intercept: Tensor
    gamma: Tensor

    def __init__(self, n_channels: int, n_targets: int):
        super().__init__()
        self.register_buffer("support", torch.empty(0, n_channels))
        self.register_buffer("dual", torch.empty(n_targets, 0, dtype=torch.float64))
        self.register_buffer("intercept", torch.empty(n_targets, dtype=torch.float64))
        self.register_buffer("gamma", torch.empty((), dtype=torch.float64))

    def fit(self, voltage: Tensor, state: Tensor, C: float, epsilon: float) -> None:
        """Fit a regression for each target to standardised voltages (n, M) and states (n, T), with
        the settings of `train.Tube`. It is deterministic."""
        from sklearn.svm import SVR  # here, as only this fit needs it

        voltages, states = voltage.double().cpu().numpy(), state.double().cpu().numpy()
        gamma = 1.0 / (voltages.shape[1] * voltages.var())
        dual, intercept = np.zeros((states.shape[1], len(voltages))), np.zeros(states.shape[1])
        for k, target in enumerate(states.T):
            fitted = SVR(C=C, epsilon=epsilon, gamma=gamma).fit(voltages, target)
            dual[k, fitted.support_] = fitted.dual_coef_[0]
            intercept[k] = fitted.intercept_[0]
        support = np.flatnonzero((dual != 0).any(axis=0))
        vectors = {
            "support": voltage.cpu()[support],
            "dual": torch.from_numpy(dual[:, support]),
            "intercept": torch.from_numpy(intercept),
            "gamma": torch.tensor(gamma, dtype=torch.float64),
        }
        self.load_state_dict(vectors)
        self.to(voltage.device)

    def _load_from_state_dict(self, state_dict: dict, prefix: str, *arguments: object) -> None:
        """As PyTorch's, with the number of vectors of the file."""
        for name in ("support", "dual"):
            self.register_buffer(name, torch.empty_like(state_dict[prefix + name]))
        super()._load_from_state_dict(state_dict, prefix, *arguments)

    def forward(self, voltage: Tensor) -> Tensor:
        v, s = voltage.double(), self.support.double()
        square = v.square().sum(1, keepdim=True) + s.square().sum(1) - 2 * v @ s.T
        return torch.exp(-self.gamma * square) @ self.dual.T + self.intercept


def svr(shape: Shape) -> Svr:
    """A regression without support vectors."""
    return Svr(shape.n_channels, shape.n_targets)
