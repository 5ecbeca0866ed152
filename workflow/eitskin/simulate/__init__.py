"""What a board would read of a skin: frames, sets of touches, the twin."""

import sys

from eitskin.callable_package import CallablePackage

sys.modules[__name__].__class__ = CallablePackage  # for eitskin.simulate(...)
