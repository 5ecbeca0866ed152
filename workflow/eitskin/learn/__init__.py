"""Estimators of touches: networks, their training, their errors."""
