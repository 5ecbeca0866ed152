"""What a diagnosis is worth to an estimator: trained on simulators, tested on the recording."""
