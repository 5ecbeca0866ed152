"""What physics allows an estimator: posterior means and bounds."""
