"""Which set of effects explains a recording: the rules, the steps and the refusals."""
