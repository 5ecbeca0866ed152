"""What scatters when nothing is wrong: noise, errors of the rig, and the covariance of both."""
