"""An independent simulator: recordings in which one knows what is concealed.

It shares no solving code with `eitskin`: boundary integral equations in physical space instead of a
conformal map with multipoles, and every law written once more from its definition. `generators` has
three more solvers: finite elements on triangles, a slab of prisms, and the analytic disc.
"""
