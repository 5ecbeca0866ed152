"""Trained predictors in one file each, read and applied without torch."""
