"""Named effects fitted to a recording under the covariance of its noise."""
