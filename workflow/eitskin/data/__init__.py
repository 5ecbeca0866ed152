"""Recordings and what is made of them: data sets, baselines, splits, checks."""
