"""Estimators of touch, trained on simulators of a recording."""
