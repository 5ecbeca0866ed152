"""An emulated rig, a process of its own: one physical world behind a UR controller's TCP ports and
the pseudo-terminals of an EIT board and a load cell."""
