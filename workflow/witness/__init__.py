"""An independent simulator of recordings with known truth.

It shares no solver with `eitskin`: boundary integral equations in physical space in place of a
conformal map with multipoles, and every law implemented a second time from its definition.
`generators` has three more solvers: finite elements on triangles, a slab of prisms, and the
analytic disc.
"""
