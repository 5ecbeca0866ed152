"""What the tests of the loop conceal, and the forces where nobody measured any."""

FORCES = {"mean_N": 5.0, "sd_N": 2.0, "max_N": 10.0}
LAW = {"name": "contact-law", "parameters": {"exponent": 0.7}}
JITTER = {"name": "electrode-position", "parameters": {"shift_deg": {"sd": 0.5}}}
