"""The strengths in the authors' public code, and their forces."""

EFFECTS = [
    {"name": "ellipse", "parameters": {"sx": {"sd": 0.03}, "sy": {"sd": 0.03}}},
    {"name": "electrode-position", "parameters": {"shift_deg": {"sd": 0.5}}},
    {"name": "channel-gain", "parameters": {"gain": {"sd": 0.04, "tie": "mirror"}}},
    {"name": "force-dependent-gain", "parameters": {"per_N": 0.005, "F_mid_N": 5.0}},
    {"name": "crosstalk", "parameters": {"epsilon": 0.03}},
]
FORCES = {"mean_N": 5.0, "sd_N": 2.0, "max_N": 10.0}
