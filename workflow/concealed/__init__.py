"""The proof on concealed effects: recordings whose truth is sealed until the verdicts are."""
